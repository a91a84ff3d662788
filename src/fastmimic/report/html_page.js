"use strict";
(() => {
  const root = document.documentElement;
  const plots = JSON.parse(document.getElementById("plots").textContent);
  const touch = matchMedia("(pointer: coarse)").matches;

  // Colours are named in the data as var(--name) and taken from the style sheet, so that they follow the theme.
  const paint = (value, style) => {
    if (typeof value === "string") {
      return value.replace(/var\((--[a-z]+)\)/g, (_, name) => style.getPropertyValue(name).trim());
    }
    if (Array.isArray(value)) return typeof value[0] === "number" ? value : value.map((v) => paint(v, style));
    if (value && typeof value === "object") {
      return Object.fromEntries(Object.entries(value).map(([k, v]) => [k, paint(v, style)]));
    }
    return value;
  };

  const axis = (given, style) => ({
    gridcolor: style.getPropertyValue("--grid").trim(),
    linecolor: style.getPropertyValue("--line").trim(),
    tickcolor: style.getPropertyValue("--line").trim(),
    zeroline: false, automargin: true, nticks: 6, ...given,
    title: { standoff: 8, font: { size: 12.5, color: style.getPropertyValue("--muted").trim() }, ...given.title },
  });

  const draw = () => {
    const style = getComputedStyle(root);
    const ink = style.getPropertyValue("--ink").trim();
    const font = { family: getComputedStyle(document.body).fontFamily, size: 12, color: ink };
    for (const box of document.querySelectorAll(".plot")) {
      const plot = paint(plots[box.id], style);
      const given = plot.layout;
      const layout = {
        ...given, font, width: box.clientWidth, showlegend: false, dragmode: touch ? false : "zoom",
        paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", margin: { l: 8, r: 8, t: 8, b: 8 },
        hovermode: given.hovermode === undefined ? "x unified" : given.hovermode,
        hoverlabel: { bgcolor: style.getPropertyValue("--card").trim(), bordercolor: style.getPropertyValue("--line").trim(), font },
        xaxis: axis(given.xaxis, style), yaxis: axis(given.yaxis, style),
      };
      Plotly.react(box, plot.data, layout, { displayModeBar: false, displaylogo: false });
    }
    root.dataset.drawn = String(document.querySelectorAll(".plot").length);
  };

  draw();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  let waiting = 0, width = root.clientWidth;
  addEventListener("resize", () => {
    clearTimeout(waiting);
    waiting = setTimeout(() => { if (root.clientWidth !== width) { width = root.clientWidth; draw(); } }, 120);
  });
  addEventListener("beforeprint", () => { root.classList.add("print"); draw(); });
  addEventListener("afterprint", () => { root.classList.remove("print"); draw(); });
})();
