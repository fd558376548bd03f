// What the page knows: the latest of everything, and the moments of the last minutes to go back to.

const MINUTES = 10;
const MOMENT_S = 0.5;
const MAX_MOMENTS = (MINUTES * 60) / MOMENT_S;
const MAX_CALLS = 600;
const RECENT = 24;
const TRACKS_HOLD_S = 2;

/** Return the state of localisation of a moment: as the node says, but for one that has not yet said that it is lost. */
export function stateOf(moment) {
  const lost = Boolean(moment.rows[moment.rowCount - 1]?.lost);
  const word = moment.nodes?.nodes.find((item) => item.name === "localisation_node")?.state || "tracking";
  return lost && word.startsWith("tracking") ? "lost" : word;
}

export class Store {
  constructor() {
    this.server = {};
    this.rows = [];
    this.calls = [];
    this.report = null;
    this.nodes = null;
    this.images = new Map();
    this.clouds = new Map();
    this.elevation = null;
    this.recent = [];
    this.tracked = null;
    this.underWay = null;
    this.ended = false;
    this.events = [];
    this.moments = [];
    this.thinned = { images: 0 };
  }

  /** Take a message of figures in. */
  apply(message) {
    ({
      hello: () => this.begin(message),
      report: () => (this.report = message),
      path: () => this.addRows(message),
      calls: () => this.addCalls(message),
      nodes: () => this.addNodes(message),
      events: () => (this.events = message.events),
    })[message.type]?.();
  }

  begin(message) {
    this.server = message.server;
    this.fields = Object.fromEntries(message.row_fields.map((name, place) => [name, place]));
  }

  addRows(message) {
    if (message.whole) this.rows = [];
    const place = this.fields;
    for (const row of message.rows) {
      this.rows.push({
        n: row[place.n], stamp: row[place.stamp_ns], received: row[place.received_s], published: row[place.published_s],
        at: row[place.position_m], covariance: row[place.covariance_xy_m2], lost: row[place.lost],
        truth: row[place.truth_m], error: row[place.error_m], distance: row[place.distance_m],
        judged: row[place.judged_m], judgedSigma: row[place.judged_sigma_m],
      });
    }
    if (!this.moments.length && message.whole) this.fillPast();
    this.underWay = message.under_way;
  }

  /** Make moments of what was before the page was loaded: path and calls are known of them, figures are not. */
  fillPast() {
    this.rows.forEach((row, place) => {
      if (row.received - (this.moments.at(-1)?.time ?? 0) < MOMENT_S) return;
      this.moments.push({ time: row.received, rows: this.rows, rowCount: place + 1, calls: [], report: null, nodes: null, images: new Map(), clouds: new Map(), elevation: null, tracked: null, underWay: null, kept: false });
    });
    this.moments = this.moments.slice(-MAX_MOMENTS);
  }

  /** Return the moment that was shown at a time. */
  momentAt(time) {
    const found = this.moments.findLast((moment) => moment.time <= time) ?? this.moments[0];
    return found && { ...found, calls: found.kept ? found.calls : this.calls.filter((call) => call.received_s <= found.time) };
  }

  addCalls(message) {
    this.calls = (message.whole ? [] : this.calls).concat(message.calls).slice(-MAX_CALLS);
  }

  addNodes(message) {
    this.nodes = message;
    this.ended = message.ended;
    const last = this.moments.at(-1);
    if (last && message.time_s - last.time < MOMENT_S * 0.8) return;
    this.moments.push(this.moment());
    if (this.moments.length > MAX_MOMENTS) this.moments.shift();
  }

  addImage(header, blob) {
    const before = this.images.get(header.topic);
    this.images.set(header.topic, { ...header, blob });
    if (header.topic.startsWith("loc/")) this.recent = [...this.recent.slice(1 - RECENT), this.images.get(header.topic)];
    if (before && before.stamp_ns === header.stamp_ns) return;
    if (header.size[0] < header.full_size[0]) this.thinned.images = header.full_size;
  }

  /** Take a cloud, a map from above or feature tracks in. */
  addValues(header, values) {
    if (header.type === "elevation") this.elevation = { ...header, values };
    else if (header.type === "tracks") this.addTracks({ ...header, values });
    else this.clouds.set(header.topic, { ...header, values, columns: header.error ? 5 : 4 });
  }

  /** Put tracks and the images of their stamp together. */
  addTracks(tracks) {
    const of = (side) => this.recent.findLast((image) => image.topic === `loc/${side}` && image.stamp_ns === tracks.stamp_ns);
    if (of("left")) this.tracked = { tracks, images: { left: of("left"), right: of("right") } };
  }

  /** Return the newest tracks with their images, null where none come any more. */
  latestTracked() {
    const newest = this.images.get("loc/left"), own = this.tracked?.images.left;
    return own && newest && newest.published_s - own.published_s < TRACKS_HOLD_S ? this.tracked : null;
  }

  /** Return what is known now; nothing in it is changed later, so that it can be shown again. */
  moment() {
    return {
      time: this.nodes ? this.nodes.time_s : 0, rows: this.rows, rowCount: this.rows.length, calls: this.calls,
      report: this.report, nodes: this.nodes, images: new Map(this.images), clouds: new Map(this.clouds),
      elevation: this.elevation, tracked: this.latestTracked(), underWay: this.underWay, kept: true,
    };
  }
}
