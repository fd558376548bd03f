// The websocket, which reconnects automatically, and commands to the nodes.

const FIRST_WAIT_MS = 250;
const LONGEST_WAIT_MS = 2000;
const SILENT_MS = 1500; // the server sends the state of the run four times a second
const WATCH_MS = 500;

export class Connection {
  /** Connect; call `onMessage(message)` for each JSON message and `onMedia(header, bytes)` for each image or map. */
  constructor({ onMessage, onMedia }) {
    this.onMessage = onMessage;
    this.onMedia = onMedia;
    this.isHeard = false; // whether the server sends
    this.lostMs = 0; // time since which the server is no longer heard; 0 while it is heard, and before the first time
    this.isVisible = false;
    this.waitMs = FIRST_WAIT_MS;
    this.heardMs = 0;
    this.connect();
    setInterval(() => this.watch(), WATCH_MS);
  }

  connect() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    this.socket = new WebSocket(`${scheme}://${location.host}/ws`);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => {
      this.waitMs = FIRST_WAIT_MS;
      this.heardMs = performance.now();
      this.reportVisible(this.isVisible);
    };
    this.socket.onmessage = (event) => this.receive(event.data);
    this.socket.onclose = () => {
      this.note(false);
      setTimeout(() => this.connect(), this.waitMs);
      this.waitMs = Math.min(this.waitMs * 2, LONGEST_WAIT_MS);
    };
  }

  get isOpen() {
    return this.socket.readyState === WebSocket.OPEN;
  }

  /** Report to the server whether the page is visible. It sends images and maps only to a visible page. */
  reportVisible(visible) {
    this.isVisible = visible;
    if (this.isOpen) this.socket.send(JSON.stringify({ type: "visible", visible }));
  }

  /** An open but silent connection counts as lost. */
  watch() {
    if (this.isOpen) this.note(performance.now() - this.heardMs < SILENT_MS);
  }

  note(isHeard) {
    if (isHeard) this.lostMs = 0;
    else if (this.isHeard) this.lostMs = Date.now();
    this.isHeard = isHeard;
  }

  receive(data) {
    this.heardMs = performance.now();
    this.note(true);
    if (typeof data === "string") {
      this.onMessage(JSON.parse(data));
      return;
    }
    const size = new DataView(data).getUint32(0, true);
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, size)));
    this.onMedia(header, data.slice(4 + size));
  }
}

/** Send a command to the nodes; return the text of the result, or throw an error with the reason. */
export async function command(content) {
  const token = document.querySelector('meta[name="command-token"]').content;
  const headers = { "Content-Type": "application/json", "X-SFR-Token": token };
  const answer = await fetch("command", { method: "POST", headers, body: JSON.stringify(content) });
  const { ok, text } = await answer.json();
  if (!ok) throw new Error(text);
  return text;
}
