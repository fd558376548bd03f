// The websocket: connects again by itself, tells the lag of clocks, takes binary frames apart.

const PING_MS = 5000;
const LONGEST_WAIT_MS = 2000;
const SILENT_MS = 1500;

export class Connection {
  /** Connect. `on` has figures(message), image(header, blob), values(header, values), state(connected, since). */
  constructor(on) {
    this.on = on;
    this.offset = 0;
    this.views = [];
    this.waitMs = 250;
    this.heard = 0;
    this.connect();
    setInterval(() => this.ping(), PING_MS);
    setInterval(() => this.watch(), 500);
  }

  connect() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/ws`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.waitMs = 250;
      this.heard = performance.now();
      this.on.state(true);
      this.want(this.views);
      this.ping();
    };
    socket.onmessage = (event) => this.receive(event.data);
    socket.onclose = () => {
      this.on.state(false);
      setTimeout(() => this.connect(), this.waitMs);
      this.waitMs = Math.min(this.waitMs * 2, LONGEST_WAIT_MS);
    };
    this.socket = socket;
  }

  get isOpen() {
    return this.socket.readyState === WebSocket.OPEN;
  }

  /** Say which images and clouds are looked at. */
  want(views) {
    this.views = views;
    if (this.isOpen) this.socket.send(JSON.stringify({ type: "want", views }));
  }

  ping() {
    if (this.isOpen) this.socket.send(JSON.stringify({ type: "ping", sent_ms: Date.now() }));
  }

  /** A connection that is open and says nothing is none. */
  watch() {
    if (this.isOpen) this.on.state(performance.now() - this.heard < SILENT_MS);
  }

  receive(data) {
    this.heard = performance.now();
    if (typeof data === "string") {
      const message = JSON.parse(data);
      if (message.type === "pong") this.offset = message.time_s - (message.sent_ms + Date.now()) / 2000;
      else this.on.figures(message);
      return;
    }
    const size = new DataView(data).getUint32(0, true);
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, size)));
    if (header.type === "image") this.on.image(header, new Blob([new Uint8Array(data, 4 + size)], { type: "image/jpeg" }));
    else this.on.values(header, new Float32Array(data, 4 + size));
  }

  /** The server's time now, seconds since 1970. */
  now() {
    return Date.now() / 1000 + this.offset;
  }
}

/** Ask something of the nodes; return what was done, or throw why not. */
export async function command(content) {
  const token = document.querySelector('meta[name="command-token"]').content;
  const headers = { "Content-Type": "application/json", "X-SFR-Token": token };
  const answer = await fetch("command", { method: "POST", headers, body: JSON.stringify(content) });
  const { ok, text } = await answer.json();
  if (!ok) throw new Error(text);
  return text;
}
