"use strict";
(() => {
  const dark = matchMedia("(prefers-color-scheme: dark)");

  // A text that the page keeps compressed.
  const kept = async (name) => {
    const packed = Uint8Array.from(atob(document.getElementById(name).textContent), (c) => c.charCodeAt(0));
    return new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
  };

  const old = () => {
    const line = document.createElement("p");
    line.className = "notes";
    line.textContent = "The replay needs a browser of 2023 or later; all else does not.";
    document.querySelector("nav, h2, main > :last-child").before(line);
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
  document.documentElement.dataset.ready = "yes";
})();
