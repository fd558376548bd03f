"use strict";
(function () {
  const template = JSON.parse(document.getElementById("template").textContent);
  const palettes = template.palettes;
  const holder = document.getElementById("specs");
  const specs = JSON.parse(holder.textContent);
  const every = Number(holder.dataset.every);
  const root = document.documentElement;
  const system = window.matchMedia("(prefers-color-scheme: dark)");
  let theme = system.matches ? "dark" : "light";
  let chosen = null;

  function coloured(value, palette) {
    if (typeof value === "string") {
      return value.startsWith("@") ? palette[value.slice(1)] : value;
    }
    if (Array.isArray(value)) {
      return typeof value[0] === "number" ? value : value.map((item) => coloured(item, palette));
    }
    if (value === null || typeof value !== "object") return value;
    return Object.fromEntries(Object.entries(value).map(([key, item]) => [key, coloured(item, palette)]));
  }

  function themed(spec, palette) {
    const shared = coloured(template, palette);
    const layout = Object.assign({ autosize: true, height: spec.height }, shared.layout, coloured(spec.layout, palette));
    for (const name of Object.keys(layout)) {
      if (/^[xy]axis\d*$/.test(name)) layout[name] = Object.assign({}, shared.axis, layout[name]);
    }
    if (layout.scene) {
      for (const name of ["xaxis", "yaxis", "zaxis"]) {
        layout.scene[name] = Object.assign({}, shared.axis_in_space, layout.scene[name]);
      }
    }
    return { data: coloured(spec.data, palette), layout: layout };
  }

  function draw() {
    root.dataset.theme = theme;
    const other = theme === "dark" ? "Light" : "Dark";
    document.getElementById("theme").textContent = other;
    const config = { displaylogo: false, responsive: true, displayModeBar: false };
    return Promise.all(specs.map((spec) => {
      const made = themed(spec, palettes[theme]);
      const place = document.getElementById(spec.name);
      return Plotly.react(place, made.data, made.layout, config).then(() => place);
    })).then((places) => {
      if (chosen) mark(chosen);
      root.dataset.figures = places.filter((place) => place.querySelector("svg, canvas")).length + "/" + specs.length;
      return places;
    });
  }

  // Show a sub-trajectory, given by the five values of its mark, in the view from above. The path has one row per
  // `every` frames.
  function mark(selected) {
    const view = document.getElementById("top-view");
    if (!view) return;
    chosen = selected;
    const at = view.data.findIndex((trace) => trace.name === "chosen sub-trajectory");
    const truth = view.data.find((trace) => trace.name === "truth");
    const from = Math.ceil(selected[1] / every), to = Math.floor(selected[2] / every) + 1;
    Plotly.restyle(view, { x: [truth.x.slice(from, to)], y: [truth.y.slice(from, to)] }, [at]);
  }

  document.getElementById("theme").addEventListener("click", () => {
    theme = theme === "dark" ? "light" : "dark";
    draw();
  });
  system.addEventListener("change", (event) => { theme = event.matches ? "dark" : "light"; draw(); });

  function resize(spec, layout, height) {
    document.getElementById(spec.name).style.height = height + "px";
    Plotly.relayout(spec.name, Object.assign({ height: height }, layout));
  }

  // On paper: light theme, width of A4 minus the margins at 96 CSS pixels per inch, and at most the height of the page.
  const PAPER_WIDTH = 670, PAPER_HEIGHT = 860, HALF_PAGE = 400;

  function heightOnPaper(spec) {
    const isStacked = spec.layout.grid !== undefined;
    return isStacked ? Math.min(spec.height, PAPER_HEIGHT) : Math.min(spec.height, HALF_PAGE);
  }

  let before = null;
  window.addEventListener("beforeprint", () => {
    before = theme;
    theme = "light";
    draw();
    specs.forEach((spec) => resize(spec, { autosize: false, width: PAPER_WIDTH }, heightOnPaper(spec)));
  });
  window.addEventListener("afterprint", () => {
    theme = before;
    specs.forEach((spec) => resize(spec, { autosize: true, width: null }, spec.height));
    draw();
  });

  async function load() {
    const packed = Uint8Array.from(atob(document.getElementById("plotly").textContent), (sign) => sign.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    const script = document.createElement("script");
    script.textContent = await new Response(stream).text();
    document.head.append(script);
  }

  load().then(draw).then((places) => places.forEach((place) => place.on("plotly_click", (event) => {
    const data = event.points[0].customdata;
    if (Array.isArray(data) && data.length === 5) mark(data);
  })));
})();
