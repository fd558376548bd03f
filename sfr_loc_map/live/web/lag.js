// How late the page is: from the publication of an image to the frame in which what follows from it is drawn.

const KEPT = 500;

export class Lag {
  constructor() {
    this.poses = [];
    this.images = [];
    this.due = [];
    this.since = Infinity;
  }

  /** Count what is published from now on: what a page is given when it joins is old. */
  begin(time) {
    this.since = time;
  }

  /** Expect the newest pose in the next frame. */
  expect(row) {
    if (row && row.published > this.since && row.n !== this.last) {
      this.last = row.n;
      this.due.push([this.poses, row.published, row.stamp]);
    }
  }

  /** Note that an image was drawn on its canvas, outside of a frame: the next one shows it. */
  imageDrawn(image, now) {
    if (image.published_s <= this.since) return;
    requestAnimationFrame(() => this.note([[this.images, image.published_s, image.stamp_ns]], now));
  }

  /** Note that a frame was drawn. */
  drawn(now, live) {
    const due = this.due.splice(0);
    if (due.length && live) this.note(due, now);
  }

  /** Note times once the browser has come back from painting the frame that is being made. */
  note(due, now) {
    setTimeout(() => {
      const time = now();
      for (const [kept, published, stamp] of due) {
        kept.push([time - published, stamp]);
        if (kept.length > KEPT) kept.shift();
      }
    });
  }

  /** Return the value that so many of 100 lie below, milliseconds. */
  percentile(kept, percent) {
    const sorted = kept.map(([seconds]) => seconds * 1000).sort((a, b) => a - b);
    return sorted[Math.min(Math.floor((percent / 100) * sorted.length), sorted.length - 1)];
  }

  text() {
    if (!this.poses.length && !this.images.length) return "Lag of this page: not known yet.";
    const parts = [["poses", this.poses], ["images", this.images]].filter(([, kept]) => kept.length);
    const words = parts.map(([name, kept]) => `${name} ${Math.round(this.percentile(kept, 50))} ms, 95 % within ${Math.round(this.percentile(kept, 95))} ms`);
    return `Image to screen: ${words.join("; ")}.`;
  }
}
