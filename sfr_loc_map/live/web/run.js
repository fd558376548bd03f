// The data of the run: the latest message of each kind, and the poses and calls so far. live/messages.py lists the kinds.

const MAX_CALLS = 600;

export class Run {
  constructor() {
    this.title = "";
    this.live = null; // state of the run: headline, localisation, nodes, topics
    this.report = null; // tables, limits and errors of the latest report
    this.events = [];
    this.poses = [];
    this.beforeM = 0; // distance travelled before the first pose
    this.calls = [];
    this.images = new Map(); // by topic
    this.map = null; // map from above
  }

  /** Add a JSON message. */
  take(message) {
    switch (message.type) {
      case "hello":
        this.title = message.title;
        this.rowFields = message.row_fields;
        this.calls = []; // all calls are sent again
        break;
      case "live":
        this.live = message;
        break;
      case "report":
        this.report = message;
        break;
      case "events":
        this.events = message.events;
        break;
      case "path":
        this.takePath(message);
        break;
      case "calls":
        this.calls = this.calls.concat(message.calls).slice(-MAX_CALLS);
        break;
    }
  }

  /** Add poses, whose fields were named by the server's first message. */
  takePath(message) {
    const poseOf = (row) => Object.fromEntries(this.rowFields.map((name, place) => [name, row[place]]));
    const poses = message.rows.map(poseOf);
    this.poses = message.whole ? poses : this.poses.concat(poses);
    this.beforeM = message.before_m;
  }

  /** Add an image or a map from above. */
  takeMedia(header, bytes) {
    if (header.type === "image") {
      this.images.set(header.topic, { ...header, blob: new Blob([bytes], { type: "image/jpeg" }) });
    } else {
      this.map = { ...header, values: new Float32Array(bytes) };
    }
  }

  get ended() {
    return Boolean(this.live?.ended);
  }

  get lastPose() {
    return this.poses.at(-1);
  }

  /** The last pose, its state and the text of the state; null before the first pose. */
  get localisation() {
    const localisation = this.live?.localisation;
    if (!localisation) return null;
    const text = [localisation.state || "state unknown", localisation.reason].filter(Boolean).join(": ");
    return { ...localisation, text };
  }
}
