// What the wheel and the pointer do on a canvas: zoom about the pointer, drag, double click for all; the place pointed at.

const MOST = 1000;

export class View {
  /** `redraw` is called with each change; without `zooms` only the pointer is followed. */
  constructor(canvas, redraw, zooms = true) {
    Object.assign(this, { zoom: 1, x: 0, y: 0, pointer: null, version: 0 });
    const changed = () => ((this.version += 1), redraw());
    const place = (event) => [event.offsetX, event.offsetY];
    canvas.addEventListener("pointerleave", () => ((this.pointer = null), changed()));
    canvas.addEventListener("pointermove", (event) => {
      this.pointer = place(event);
      if (zooms && event.buttons) [this.x, this.y] = [this.x + event.movementX, this.y + event.movementY];
      changed();
    });
    if (!zooms) return;
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const zoom = Math.min(Math.max(this.zoom * Math.exp(-event.deltaY * 0.0015), 1), MOST), factor = zoom / this.zoom;
      const [x, y] = place(event), middle = [canvas.clientWidth / 2, canvas.clientHeight / 2];
      this.x = zoom === 1 ? 0 : x - middle[0] - (x - middle[0] - this.x) * factor;
      this.y = zoom === 1 ? 0 : y - middle[1] - (y - middle[1] - this.y) * factor;
      this.zoom = zoom;
      changed();
    }, { passive: false });
    canvas.addEventListener("dblclick", () => (Object.assign(this, { zoom: 1, x: 0, y: 0 }), changed()));
  }

  /** Return where a place of the whole view, pixels, is shown. */
  at(x, y, width, height) {
    return [width / 2 + (x - width / 2) * this.zoom + this.x, height / 2 + (y - height / 2) * this.zoom + this.y];
  }
}

/** Write what the pointer is at, beside it. */
export function label(context, [x, y], text, width, colours) {
  context.font = "12px system-ui, sans-serif";
  const wide = context.measureText(text).width + 12, left = Math.max(Math.min(x + 12, width - wide - 2), 2), top = Math.max(y - 30, 2);
  context.fillStyle = colours.text;
  context.beginPath(), context.roundRect(left, top, wide, 22, 5), context.fill();
  context.fillStyle = colours.card;
  context.textAlign = "left";
  context.fillText(text, left + 6, top + 15);
}
