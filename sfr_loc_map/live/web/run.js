// The data of the run: the latest message of each kind, and the poses and calls so far. live/messages.py lists the kinds.

export class Run {
  constructor() {
    this.forget();
  }

  /** Forget all data, because each connection receives them again, perhaps from a new server. */
  forget() {
    this.title = "";
    this.live = null; // state of the run: headline, localisation, nodes, topics
    this.score = null; // tables, limits and errors of the latest score
    this.events = [];
    this.keptPoses = []; // poses of the thinned path
    this.lastPose = null; // even if the thinned path does not contain the pose
    this.beforeM = 0; // distance travelled before the first pose
    this.calls = [];
    this.images = new Map(); // by topic
    this.map = null; // map from above
  }

  /** Add a JSON message. */
  take(message) {
    switch (message.type) {
      case "hello":
        this.forget();
        this.title = message.title;
        break;
      case "live":
        this.live = message;
        break;
      case "score":
        this.score = message;
        break;
      case "events":
        this.events = message.events;
        break;
      case "path":
        this.takePath(message);
        break;
      case "calls":
        this.calls = this.calls.concat(message.calls).filter((call) => call.n >= message.first);
        break;
    }
  }

  /** Add poses, or replace all poses. */
  takePath(message) {
    this.keptPoses = message.whole ? message.rows : this.keptPoses.concat(message.rows);
    this.lastPose = message.last;
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

  /** Return a sentence about something missing with the time: until now, or until the end of the run. */
  missing(sentence) {
    return `${sentence} ${this.ended ? "before the end of the run" : "yet"}`;
  }

  /** The poses of the thinned path, and the last pose. */
  get poses() {
    const isKept = !this.lastPose || this.keptPoses.at(-1)?.n === this.lastPose.n;
    return isKept ? this.keptPoses : [...this.keptPoses, this.lastPose];
  }

  /** The last pose, its state and the text of the state; null before the first pose. */
  get localisation() {
    const localisation = this.live?.localisation;
    if (!localisation) return null;
    const text = [localisation.state || "state unknown", localisation.reason].filter(Boolean).join(": ");
    return { ...localisation, text };
  }
}
