"use strict";
(function () {
  // Colours of Okabe and Ito (told apart by all kinds of colour vision), darker on light, lighter on dark.
  const palettes = {
    light: {
      truth: "#1a1f24", one: "#0067a8", two: "#c14a00", three: "#007a5a", four: "#8a6d00", five: "#a3437b",
      "one-soft": "rgba(0,103,168,0.16)", "two-soft": "rgba(193,74,0,0.16)", "three-soft": "rgba(0,122,90,0.16)",
      "four-soft": "rgba(138,109,0,0.16)", "five-soft": "rgba(163,67,123,0.16)",
      bad: "#b3001b", faint: "rgba(87,96,106,0.35)", chosen: "#e69f00", ink: "#1a1f24", soft: "#57606a",
      paper: "#ffffff", grid: "#e3e7eb", zero: "#8c959f",
    },
    dark: {
      truth: "#f0f3f6", one: "#56b4e9", two: "#ff9a52", three: "#3ecf9f", four: "#f0e442", five: "#e49ac4",
      "one-soft": "rgba(86,180,233,0.2)", "two-soft": "rgba(255,154,82,0.2)", "three-soft": "rgba(62,207,159,0.2)",
      "four-soft": "rgba(240,228,66,0.2)", "five-soft": "rgba(228,154,196,0.2)",
      bad: "#ff7b7b", faint: "rgba(169,180,191,0.35)", chosen: "#ffd166", ink: "#e8ecf0", soft: "#a9b4bf",
      paper: "#171c22", grid: "#2b333c", zero: "#6b7682",
    },
  };
  const holder = document.getElementById("specs");
  const specs = JSON.parse(holder.textContent);
  const every = Number(holder.dataset.every);
  const root = document.documentElement;
  const system = window.matchMedia("(prefers-color-scheme: dark)");
  let theme = system.matches ? "dark" : "light";
  let chosen = null;

  function coloured(value, palette) {
    if (typeof value === "string") {
      if (value === "@sequential") return "Viridis";
      return value.startsWith("@") ? palette[value.slice(1)] : value;
    }
    if (Array.isArray(value)) {
      return typeof value[0] === "number" ? value : value.map((item) => coloured(item, palette));
    }
    if (value === null || typeof value !== "object") return value;
    return Object.fromEntries(Object.entries(value).map(([key, item]) => [key, coloured(item, palette)]));
  }

  function themed(spec, palette) {
    const layout = Object.assign({
      margin: { l: 60, r: 20, t: 12, b: 50 },
      font: { color: palette.ink, size: 12, family: "system-ui, Segoe UI, Roboto, DejaVu Sans, Arial, sans-serif" },
      paper_bgcolor: palette.paper, plot_bgcolor: palette.paper,
      legend: { orientation: "h", traceorder: "normal", y: 1.02, yanchor: "bottom", x: 0 },
      hovermode: "closest", hoverlabel: { align: "left" }, autosize: true, height: spec.height,
    }, coloured(spec.layout, palette));
    const lines = { gridcolor: palette.grid, zerolinecolor: palette.zero, linecolor: palette.zero };
    for (const name of Object.keys(layout)) {
      if (/^[xy]axis\d*$/.test(name)) layout[name] = Object.assign({ zeroline: false }, lines, layout[name]);
    }
    if (layout.scene) {
      for (const name of ["xaxis", "yaxis", "zaxis"]) {
        layout.scene[name] = Object.assign({ backgroundcolor: palette.paper }, lines, layout.scene[name]);
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

  // The segment of a sub-trajectory is shown in the view from above: its frames are rows of the path, one in `every`.
  function mark(segment) {
    const view = document.getElementById("top-view");
    if (!view) return;
    chosen = segment;
    const at = view.data.findIndex((trace) => trace.name === "chosen sub-trajectory");
    const truth = view.data.find((trace) => trace.name === "truth");
    const from = Math.ceil(segment[1] / every), to = Math.floor(segment[2] / every) + 1;
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

  // On paper: light, as wide as the page (A4 less its margins, at 96 CSS pixels an inch), two figures on a page.
  let before = null;
  window.addEventListener("beforeprint", () => {
    before = theme;
    theme = "light";
    draw();
    specs.forEach((spec) => resize(spec, { autosize: false, width: 660 }, Math.min(spec.height, 400)));
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
