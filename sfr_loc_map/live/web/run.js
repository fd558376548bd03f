// The data of the run: the latest messages, and the poses and calls so far.

const MAX_CALLS = 600;

export class Run {
  constructor() {
    this.title = "";
    this.poses = [];
    this.beforeM = 0; // distance travelled before the first pose
    this.calls = [];
    this.report = null;
    this.nodes = null;
    this.events = [];
    this.images = new Map(); // by topic
    this.map = null;
  }

  /** Add a message of figures. */
  take(message) {
    switch (message.type) {
      case "hello":
        this.title = message.server.title;
        this.rowFields = message.row_fields;
        this.calls = [];
        break;
      case "report":
        this.report = message;
        break;
      case "path":
        this.takePath(message);
        break;
      case "calls":
        this.calls = this.calls.concat(message.calls).slice(-MAX_CALLS);
        break;
      case "nodes":
        this.nodes = message;
        break;
      case "events":
        this.events = message.events;
        break;
    }
  }

  /** Add poses, whose fields were named by the server's first message. */
  takePath(message) {
    const poses = message.rows.map((row) => Object.fromEntries(this.rowFields.map((name, place) => [name, row[place]])));
    this.poses = message.whole ? poses : this.poses.concat(poses);
    this.beforeM = message.before_m;
  }

  /** Add an image or a map from above. */
  takeMedia(header, bytes) {
    if (header.type === "image") this.images.set(header.topic, { ...header, blob: new Blob([bytes], { type: "image/jpeg" }) });
    else this.map = { ...header, values: new Float32Array(bytes) };
  }

  get ended() {
    return Boolean(this.nodes?.ended);
  }

  get lastPose() {
    return this.poses.at(-1);
  }

  /** The state of localisation and its text; a lost pose may arrive before the call of its node. */
  get localisation() {
    const node = this.nodes?.nodes.find(({ name }) => name === "localisation_node");
    const state = node?.state || "tracking";
    if (this.lastPose?.lost && state !== "lost") return { state: "lost", text: "lost" };
    return { state, text: node?.reason ? `${state}: ${node.reason}` : state };
  }
}
