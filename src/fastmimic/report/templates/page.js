"use strict";
(() => {
  const root = document.documentElement;
  const plots = JSON.parse(document.getElementById("plots").textContent);
  const boxes = [...document.querySelectorAll(".plot")];
  const touch = matchMedia("(pointer: coarse)").matches;
  const dark = matchMedia("(prefers-color-scheme: dark)");

  // A text that the page keeps compressed.
  const kept = async (name) => {
    const packed = Uint8Array.from(atob(document.getElementById(name).textContent), (c) => c.charCodeAt(0));
    return new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
  };

  const old = () => {
    const line = document.createElement("p");
    line.className = "notes";
    line.textContent = "Plots and replay need a browser of 2023 or later; tables and video do not.";
    document.querySelector("nav, h2, main > :last-child").before(line);
  };

  // Colours are named in the data as var(--name) and taken from the style sheet, so that they follow the theme.
  const paint = (value, style) => {
    if (typeof value === "string") {
      return value.replace(/var\((--[\w-]+)\)/g, (_, name) => style.getPropertyValue(name).trim());
    }
    if (Array.isArray(value)) return typeof value[0] === "number" ? value : value.map((v) => paint(v, style));
    if (value && typeof value === "object") {
      return Object.fromEntries(Object.entries(value).map(([k, v]) => [k, paint(v, style)]));
    }
    return value;
  };

  const axis = (given, style, paper) => ({
    gridcolor: style.getPropertyValue("--grid").trim(),
    linecolor: style.getPropertyValue("--line").trim(),
    tickcolor: style.getPropertyValue("--line").trim(),
    zeroline: false, automargin: true, nticks: 6, ...given,
    title: {
      standoff: 8, font: { size: paper ? 9.5 : 12.5, color: style.getPropertyValue("--muted").trim() }, ...given.title,
    },
  });

  const drawOne = (box) => {
    const style = getComputedStyle(root);
    const paper = root.classList.contains("print");  // smaller, so that two figures fit a page
    const font = {
      family: getComputedStyle(document.body).fontFamily, size: paper ? 10 : 12, color: style.getPropertyValue("--ink").trim(),
    };
    const plot = paint(plots[box.id], style);
    const given = plot.layout;
    const height = Math.round((paper ? 0.62 : 1) * given.height);
    box.style.height = `${height}px`;
    const layout = {
      ...given, font, height, width: box.clientWidth, showlegend: false, dragmode: touch ? false : "zoom",
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", margin: { l: 8, r: 8, t: 8, b: 8 },
      hovermode: given.hovermode === undefined ? "x unified" : given.hovermode,
      hoverlabel: {
        bgcolor: style.getPropertyValue("--card").trim(), bordercolor: style.getPropertyValue("--line").trim(), font,
      },
      xaxis: axis(given.xaxis, style, paper), yaxis: axis(given.yaxis, style, paper),
    };
    Plotly.react(box, plot.data, layout, { displayModeBar: false, displaylogo: false });
  };

  // One plot at a time, so that the page can be read and scrolled meanwhile.
  let turn = 0;
  const draw = async () => {
    const own = ++turn;
    for (const box of boxes) {
      if (own !== turn) return;
      drawOne(box);
      await new Promise((resume) => setTimeout(resume));
    }
    root.dataset.drawn = String(boxes.length);
  };

  const begin = async () => {
    if (boxes.length) {
      const library = document.createElement("script");
      library.textContent = await kept("plotly");
      document.head.append(library);
    }
    await draw();
    dark.addEventListener("change", draw);
    let waiting = 0, width = root.clientWidth;
    addEventListener("resize", () => {
      clearTimeout(waiting);
      waiting = setTimeout(() => { if (root.clientWidth !== width) { width = root.clientWidth; draw(); } }, 120);
    });
    const all = () => { turn++; boxes.forEach(drawOne); };  // before the browser goes on to print
    addEventListener("beforeprint", () => { root.classList.add("print"); all(); });
    addEventListener("afterprint", () => { root.classList.remove("print"); all(); });
  };

  for (const button of document.querySelectorAll("button[data-opens]")) {
    button.addEventListener("click", async () => {
      button.disabled = true;
      const page = await kept(button.dataset.opens);
      const frame = document.createElement("iframe");
      frame.title = button.textContent;
      frame.sandbox = "allow-scripts";
      frame.srcdoc = dark.matches ? page.replace("{darkMode:false}", "{darkMode:true}") : page;
      button.replaceWith(frame);
    });
  }

  // A column's heading sorts the table by it: numbers by their value, text by the alphabet, what is not there last.
  const value = (row, column) => {
    const cell = row.cells[column];
    const text = cell.dataset.value ?? cell.textContent.trim();
    if (text === "" || text === "–") return null;
    return /^[-+−]?\d/.test(text) ? parseFloat(text.replace("−", "-")) : text;
  };
  for (const head of document.querySelectorAll("table.sortable thead th")) {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const body = head.closest("table").tBodies[0];
      const down = head.getAttribute("aria-sort") === "ascending";
      for (const other of head.parentNode.cells) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      const order = (a, b) => {
        const [x, y] = [value(a, head.cellIndex), value(b, head.cellIndex)];
        if (x === null || y === null) return (x === null) - (y === null);
        const before = typeof x === "number" && typeof y === "number" ? x - y : String(x).localeCompare(String(y));
        return down ? -before : before;
      };
      body.append(...[...body.rows].sort(order));
    });
  }

  if (typeof DecompressionStream === "undefined") old();
  else begin();
})();
