// Which panels are drawn in a frame: those on the screen whose data has changed, slow ones at most twice a second.

const SLOW_MS = 500;

export class Panels {
  /** `again` asks for another frame. */
  constructor(again) {
    this.again = again;
    this.panels = new Map();
    this.watcher = new IntersectionObserver((entries) => this.note(entries), { rootMargin: "200px" });
  }

  /**
   * Add the panel of an element; `keyOf(moment)` is a list, equal for two moments that look the same; a slow one may wait
   * for half a second.
   */
  add(id, draw, keyOf, slow = false) {
    const element = document.getElementById(id);
    this.panels.set(element, { draw, keyOf, slow, key: null, visible: true, drawnMs: -SLOW_MS });
    this.watcher.observe(element);
  }

  note(entries) {
    for (const entry of entries) this.panels.get(entry.target).visible = entry.isIntersecting;
    this.again();
  }

  /** Draw what has changed. */
  draw(moment, common) {
    const now = performance.now();
    let waits = false;
    for (const panel of this.panels.values()) {
      if (!panel.visible) continue;
      const key = [...panel.keyOf(moment), ...common];
      if (panel.key && key.every((value, place) => value === panel.key[place])) continue;
      if (panel.slow && now - panel.drawnMs < SLOW_MS) {
        waits = true;
        continue;
      }
      [panel.key, panel.drawnMs] = [key, now];
      panel.draw(moment);
    }
    if (waits && !this.timer) this.timer = setTimeout(() => ((this.timer = 0), this.again()), SLOW_MS);
  }
}
