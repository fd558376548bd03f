// What the page knows: the latest of everything, and the moments of the last minutes to go back to.

const MINUTES = 10;
const MOMENT_S = 0.5;
const MAX_MOMENTS = (MINUTES * 60) / MOMENT_S;
const MAX_CALLS = 600;

export class Store {
  constructor() {
    this.server = {};
    this.rows = [];
    this.calls = [];
    this.report = null;
    this.nodes = null;
    this.images = new Map();
    this.clouds = new Map();
    this.underWay = null;
    this.ended = false;
    this.moments = [];
    this.thinned = { images: 0, clouds: null };
  }

  /** Take a message of figures in. */
  apply(message) {
    const take = {
      hello: () => this.begin(message),
      report: () => (this.report = message),
      path: () => this.addRows(message),
      calls: () => this.addCalls(message),
      nodes: () => this.addNodes(message),
      end: () => (this.ended = true),
    }[message.type];
    if (take) take();
  }

  begin(message) {
    this.server = message.server;
    this.fields = Object.fromEntries(message.row_fields.map((name, place) => [name, place]));
    this.ended = false;
  }

  addRows(message) {
    if (message.whole) this.rows = [];
    const place = this.fields;
    for (const row of message.rows) {
      this.rows.push({
        n: row[place.n], stamp: row[place.stamp_ns], received: row[place.received_s], published: row[place.published_s],
        at: row[place.position_m], covariance: row[place.covariance_xy_m2], lost: row[place.lost] === 1,
        truth: row[place.truth_m], error: row[place.error_m], distance: row[place.distance_m],
      });
    }
    this.underWay = message.under_way;
  }

  addCalls(message) {
    this.calls = (message.whole ? [] : this.calls).concat(message.calls).slice(-MAX_CALLS);
  }

  addNodes(message) {
    this.nodes = message;
    const last = this.moments.at(-1);
    if (last && message.time_s - last.time < MOMENT_S * 0.8) return;
    this.moments.push(this.moment());
    if (this.moments.length > MAX_MOMENTS) this.moments.shift();
  }

  addImage(header, blob) {
    const before = this.images.get(header.topic);
    this.images.set(header.topic, { ...header, blob });
    if (before && before.stamp_ns === header.stamp_ns) return;
    if (header.size[0] < header.full_size[0]) this.thinned.images = header.full_size;
  }

  addCloud(header, values) {
    this.clouds.set(header.topic, { ...header, values, columns: header.error ? 5 : 4 });
  }

  /** Return what is known now; nothing in it is changed later, so that it can be shown again. */
  moment() {
    return {
      time: this.nodes ? this.nodes.time_s : 0, rows: this.rows, rowCount: this.rows.length, calls: this.calls,
      report: this.report, nodes: this.nodes, images: new Map(this.images), clouds: new Map(this.clouds),
      underWay: this.underWay, ended: this.ended,
    };
  }
}
