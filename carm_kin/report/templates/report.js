"use strict";
(function () {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const touch = matchMedia("(pointer: coarse)").matches;
  const LIGHT = { ink: "#1b2027", grid: "#d5dae1" };
  const DARK = { ink: "#e6eaef", grid: "#3a444f" };
  const PAPER = { width: 325, height: 255, "font.size": 10 };
  const SCREEN = { width: null, height: null, autosize: true, "font.size": 12 };
  const FLAT = ["toImage", "zoom2d", "pan2d", "resetScale2d"];
  const SPACE = ["toImage", "tableRotation", "zoom3d", "pan3d", "resetCameraDefault3d"];
  const configOf = (buttons) => ({
    displaylogo: false,
    displayModeBar: touch ? false : "hover",
    modeBarButtons: [buttons],
    responsive: true,
    scrollZoom: false,
  });
  const font = { family: getComputedStyle(document.body).fontFamily, size: 12 };

  /* Colours of what plotly.js draws in space; the style sheet cannot reach there. */
  function layoutOfSpace(colours) {
    const found = { "font.color": colours.ink };
    for (const axis of ["xaxis", "yaxis", "zaxis"]) {
      found[`scene.${axis}.color`] = colours.ink;
      found[`scene.${axis}.gridcolor`] = colours.grid;
      found[`scene.${axis}.zerolinecolor`] = colours.grid;
    }
    return found;
  }

  function inColours(content, colours) {
    const copy = structuredClone(content);
    for (const [path, colour] of Object.entries(layoutOfSpace(colours))) {
      const names = path.split(".");
      const last = names.pop();
      names.reduce((part, name) => (part[name] ??= {}), copy.layout)[last] = colour;
    }
    for (const trace of copy.data) if (trace.mode === "text") trace.textfont = { color: colours.ink, size: 13 };
    return copy;
  }

  function drawSpace(plot, content) {
    if (!document.createElement("canvas").getContext("webgl")) {
      plot.classList.add("empty");
      plot.textContent = "The view in space needs WebGL, which this browser does not offer.";
      return null;
    }
    const here = () => inColours(content, dark.matches ? DARK : LIGHT);
    const picture = document.createElement("img");
    picture.className = "paper";
    picture.alt = plot.getAttribute("aria-label");
    plot.after(picture);
    dark.addEventListener("change", () => {
      const { data, layout } = here();
      layout.scene.camera = plot.layout.scene.camera;
      data.forEach((trace, k) => (trace.visible = plot.data[k].visible ?? true));
      Plotly.react(plot, data, layout, configOf(SPACE));
    });
    const { data, layout } = here();
    return Plotly.newPlot(plot, data, layout, configOf(SPACE))
      .then(() => Plotly.toImage(inColours(content, LIGHT), { format: "png", width: 900, height: 640, scale: 2 }))
      .then((url) => { picture.src = url; });
  }

  function drawFlat(plot, content) {
    if (touch) content.layout.dragmode = false;
    addEventListener("beforeprint", () => Plotly.relayout(plot, PAPER));
    addEventListener("afterprint", () => Plotly.relayout(plot, SCREEN));
    return Plotly.newPlot(plot, content.data, content.layout, configOf(FLAT));
  }

  function draw(figure) {
    const plot = figure.querySelector(".plot");
    const content = JSON.parse(figure.querySelector("script").textContent);
    content.layout.font = { ...font };
    content.layout.modebar = { bgcolor: "rgba(0,0,0,0)", color: "#8b95a1", activecolor: "#3b82f6" };
    for (const trace of content.data) if ("text" in trace) trace.text = content.words[trace.text];
    for (const key of figure.querySelectorAll(".key")) {
      key.addEventListener("click", () => {
        const on = key.getAttribute("aria-pressed") !== "true";
        key.setAttribute("aria-pressed", String(on));
        if (plot.data) Plotly.restyle(plot, { visible: on }, JSON.parse(key.dataset.members));
      });
    }
    return figure.classList.contains("space") ? drawSpace(plot, content) : drawFlat(plot, content);
  }

  addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((it) => (it.open = true)));
  Promise.all([...document.querySelectorAll("figure")].map(draw)).then(() => {
    document.documentElement.dataset.drawn = "true";
  });
})();
