"use strict";
/* Charts without dependencies: linear axes in SVG, hover, zoom by drag, buttons and keys, a mark that charts share. */
const Charts = (() => {
  const SPACE = "http://www.w3.org/2000/svg";
  const TEXT = 6.4; // width of a digit at the font size of axes [px]
  let clips = 0;
  let paperWidth = null; // width while printing [px]
  const all = [];

  function shape(name, attributes = {}, ...children) {
    const made = document.createElementNS(SPACE, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...children);
    return made;
  }

  function element(name, attributes = {}, ...children) {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...children);
    return made;
  }

  function tickStep(low, high, count) {
    const rough = (high - low) / Math.max(count, 1);
    const power = 10 ** Math.floor(Math.log10(rough));
    return [1, 2, 5, 10].find((factor) => factor * power >= rough * 0.999) * power;
  }

  function ticks(low, high, count) {
    if (!(high > low)) return [];
    let step = tickStep(low, high, count);
    for (let more = count + 1; Math.floor(high / step) - Math.ceil(low / step) < 2 && more < count + 6; more++) step = tickStep(low, high, more);
    const out = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) out.push(k * step);
    return out.map((value) => ({ value, text: fixed(value, step) }));
  }

  /* Names of which one is too long, without what all of them begin with, and then without what all end with. */
  function apart(names, room) {
    const shared = (list) => {
      let k = 0;
      while (list.length > 1 && list.every((name) => k < name.length && name[k] === list[0][k])) k++;
      return k > 3 ? k : 0;
    };
    const fit = (list) => list.every((name) => name.length <= room);
    const back = (name) => [...name].reverse().join("");
    const without = (list) => { const k = shared(list); return k ? list.map((name) => `\u2026${name.slice(k)}`) : list; };
    const begun = fit(names) ? names : without(names);
    return fit(begun) ? begun : without(begun.map(back)).map(back);
  }

  /* A name in one line or, where there is room, in two; what is longer loses its middle. */
  function inLines(text, room, two) {
    const cut = (part) => (part.length > room ? `${part.slice(0, Math.ceil(room / 2) - 1)}\u2026${part.slice(-Math.floor(room / 2))}` : part);
    if (text.length <= room || !two) return [cut(text)];
    const at = 1 + text.slice(0, room).search(/[ _./-][^ _./-]*$/) || room;
    return [text.slice(0, at), cut(text.slice(at))].map((line) => line.trim());
  }

  /* A value to the decimals that a step needs. */
  function fixed(value, step) {
    const places = Math.min(8, Math.max(0, -Math.floor(Math.log10(Math.abs(step) || 1) + 1e-9)));
    const text = Math.abs(value) < 1e-12 ? (0).toFixed(places) : value.toFixed(places);
    const [whole, part] = text.split(".");
    const grouped = whole.replace(/\B(?=(\d{3})+(?!\d))/g, ",").replace("-", "\u2212");
    return part ? `${grouped}.${part}` : grouped;
  }

  /* A value to three significant digits. */
  function short(value) {
    if (!Number.isFinite(value)) return "\u2013";
    if (value === 0) return "0";
    return fixed(value, 10 ** (Math.floor(Math.log10(Math.abs(value))) - 2));
  }

  const between = (value, low, high) => Math.min(Math.max(value, low), high);

  /* Hand a file to the reader; nothing leaves the page but by this click. */
  function save(name, blob) {
    const link = element("a", { href: URL.createObjectURL(blob), download: name });
    document.body.append(link);
    link.click();
    link.remove();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }

  /* Rows as CSV: a field with a comma, a quote or a line's end is quoted, a name that begins as a formula is marked as text. */
  function csv(rows) {
    const text = (value) => (typeof value === "string" && /^[=+@-]./.test(value) ? `'${value}` : String(value));
    const quoted = (value) => (/[",\n]/.test(value) ? `"${value.replace(/"/g, '""')}"` : value);
    const field = (value) => (Number.isNaN(value) ? "" : quoted(text(value)));
    return `${rows.map((row) => row.map(field).join(",")).join("\n")}\n`;
  }

  /* Whole numbers and the step they count, a power of ten; null where there is no number. */
  function unpack({ origin, exponent, values }) {
    const factor = 10 ** -exponent; // a whole number divided by one gives the shortest decimals
    return Float64Array.from(values, (v) => (v === null ? NaN : origin + (exponent < 0 ? v / factor : v * 10 ** exponent)));
  }

  /* The colours between which maps run, in the scheme that is shown: blue over the ground to red. */
  const scheme = matchMedia("(prefers-color-scheme: dark)");

  class Plot {
    /* host: element to fill. options:
       label(): text for readers of screens; height(width, paper): px; x, y: axis titles; zoom: "x" or "xy";
       domain(view): {x, y} shown when view is null, or y for a given x when zoom is "x"; limit: never beyond it;
       equal: one metre is as long in x as in y; digits: room for numbers beside the y axis, at least; rows: names of rows instead of a y axis;
       draw(layer, plot); hover(x, y, plot): {x, y, lines} or null; gone(): the pointer left; zoomed(view). */
    constructor(host, options) {
      Object.assign(this, { host, options, view: null, drag: null, marked: null });
      this.svg = shape("svg", { role: "img", tabindex: "0" });
      this.tip = element("div", { class: "tip", "aria-hidden": "true" });
      this.tip.hidden = true;
      host.append(this.svg, this.tip, this.buttons());
      this.svg.addEventListener("pointerdown", (event) => this.press(event));
      this.svg.addEventListener("pointermove", (event) => this.move(event));
      this.svg.addEventListener("pointerup", (event) => this.release(event));
      this.svg.addEventListener("pointercancel", () => this.abandon());
      this.svg.addEventListener("pointerleave", () => this.drag || this.point(null));
      this.svg.addEventListener("dblclick", () => this.show(null));
      this.svg.addEventListener("keydown", (event) => this.key(event));
      this.svg.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
      all.push(this);
    }

    buttons() {
      const act = { "+": ["Zoom in", () => this.scale(0.6)], "\u2212": ["Zoom out", () => this.scale(1 / 0.6)], "\u21ba": ["Show all", () => this.show(null)] };
      if (this.options.csv) {
        act.CSV = ["Save the numbers as CSV", () => save(`${this.fileName()}.csv`, new Blob([this.options.csv()], { type: "text/csv" }))];
        act.PNG = ["Save the picture as PNG", () => this.savePicture()];
      }
      const bar = element("div", { class: "zoom" });
      for (const [sign, [label, run]] of Object.entries(act)) {
        const button = element("button", { type: "button", "aria-label": label, title: label }, sign);
        button.addEventListener("click", run);
        bar.append(button);
      }
      return bar;
    }

    fileName() { return (this.options.name || "chart").replace(/[^\w-]+/g, "-"); }

    /* The drawing as a file of its own: colours and fonts spelled out, a title above, the names of series below. */
    picture() {
      const { width, height } = this.svg.viewBox.baseVal;
      const copy = this.svg.cloneNode(true);
      const style = getComputedStyle(document.documentElement);
      const keys = this.options.keys ? this.options.keys() : [];
      const title = (this.host.closest("figure").querySelector("figcaption b") || {}).textContent || "";
      const total = height + 30 + 16 * keys.length + (keys.length ? 8 : 0);
      copy.setAttribute("xmlns", SPACE);
      copy.setAttribute("viewBox", `0 -30 ${width} ${total}`);
      copy.setAttribute("width", 2 * width);
      copy.setAttribute("height", 2 * total);
      copy.prepend(shape("rect", { x: 0, y: -30, width, height: total, fill: "var(--ground)" }));
      copy.append(shape("text", { class: "axis-title title", x: 8, y: -10 }, title));
      keys.forEach(({ color, text }, k) => copy.append(
        shape("line", { x1: 10, x2: 34, y1: height + 12 + 16 * k, y2: height + 12 + 16 * k, stroke: color, "stroke-width": 3 }),
        shape("text", { x: 42, y: height + 16 + 16 * k }, text)));
      for (const text of copy.querySelectorAll("text")) {
        text.setAttribute("font-family", "system-ui, sans-serif");
        text.setAttribute("font-size", text.classList.contains("title") ? 14 : 11.5);
        text.setAttribute("fill", text.classList.contains("axis-title") ? "var(--ink)" : "var(--soft)");
      }
      const spelled = new XMLSerializer().serializeToString(copy).replace(/var\((--[\w-]+)\)/g, (_, name) => style.getPropertyValue(name).trim());
      return { text: spelled, width: 2 * width, height: 2 * total };
    }

    async savePicture() {
      const { text, width, height } = this.picture();
      const image = new Image();
      image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(text)}`;
      await image.decode();
      const canvas = element("canvas", { width, height });
      canvas.getContext("2d").drawImage(image, 0, 0);
      canvas.toBlob((blob) => save(`${this.fileName()}.png`, blob), "image/png");
    }

    sx(value) { return this.left + ((value - this.x[0]) / (this.x[1] - this.x[0])) * this.inner; }
    sy(value) { return this.top + ((this.y[1] - value) / (this.y[1] - this.y[0])) * this.tall; }
    ix(px) { return this.x[0] + ((px - this.left) / this.inner) * (this.x[1] - this.x[0]); }
    iy(px) { return this.y[1] - ((px - this.top) / this.tall) * (this.y[1] - this.y[0]); }

    redraw() {
      const { options } = this;
      // On paper strips stand in pairs, and what is low keeps its width.
      const whole = this.host.closest(".wide") && !this.host.closest("#motion");
      const paper = paperWidth && (whole ? paperWidth : this.host.closest(".thirds") ? paperWidth / 3 - 14 : paperWidth / 2 - 14);
      const width = Math.max(160, Math.round(paper || this.host.clientWidth));
      const height = Math.round(options.height(width, Boolean(paper)));
      const shown = options.domain(this.view);
      [this.x, this.y] = [shown.x, shown.y].map(([low, high]) => (high > low ? [low, high] : [low - 1, low + 1]));
      this.top = 10;
      this.tall = height - this.top - 40;
      const count = Math.max(2, Math.round(this.tall / 46));
      const longest = (list) => Math.max(2, ...list.map((tick) => tick.text.length));
      const room = Math.max(6, Math.floor(((paper ? 0.46 : 0.36) * width) / TEXT));
      const two = options.rows && this.tall / options.rows.length >= 24;
      const names = options.rows && apart(options.rows, two ? 2 * room - 4 : room).map((text, k) => {
        const lines = inLines(text, room, two);
        return { value: options.rows.length - 1 - k, lines, text: lines.reduce((a, b) => (b.length > a.length ? b : a)) };
      });
      this.left = Math.max(options.digits || 0, names ? longest(names) : longest(ticks(...this.y, count))) * TEXT + (options.y ? 30 : 10);
      this.inner = width - this.left - 12;
      if (options.equal) this.equalise();
      const yTicks = names || ticks(...this.y, count);
      const xTicks = ticks(...this.x, Math.max(2, Math.round(this.inner / 70)));
      const frame = shape("g");
      let end = -Infinity; // of the last number written: one that would touch it is left out
      for (const { value, text } of xTicks) {
        const at = this.sx(value);
        const half = (text.length * TEXT) / 2;
        frame.append(shape("line", { x1: at, x2: at, y1: this.top, y2: this.top + this.tall, stroke: "var(--grid)" }));
        const middle = Math.min(at, width - half - 1); // a number at the right edge is written whole
        if (middle - half < end + 8) continue;
        end = middle + half;
        frame.append(shape("text", { x: middle, y: this.top + this.tall + 15, "text-anchor": "middle" }, text));
      }
      for (const { value, text, lines = [text] } of yTicks) {
        const at = this.sy(value);
        frame.append(shape("line", { x1: this.left, x2: this.left + this.inner, y1: at, y2: at, stroke: "var(--grid)" }));
        lines.forEach((line, k) => frame.append(
          shape("text", { x: this.left - 6, y: at + 4 + 12 * (k - (lines.length - 1) / 2), "text-anchor": "end" }, line)));
      }
      frame.append(shape("text", { class: "axis-title", x: this.left + this.inner / 2, y: height - 6, "text-anchor": "middle" }, options.x()));
      if (options.y) {
        const middle = this.top + this.tall / 2;
        frame.append(shape("text", { class: "axis-title", x: 11, y: middle, "text-anchor": "middle", transform: `rotate(-90 11 ${middle})` }, options.y()));
      }
      const clip = `clip-${++clips}`;
      const box = { x: this.left, y: this.top, width: this.inner, height: this.tall };
      const layer = shape("g", { "clip-path": `url(#${clip})` });
      this.over = shape("g", { "clip-path": `url(#${clip})`, "pointer-events": "none" });
      this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
      this.svg.setAttribute("aria-label", options.label());
      this.svg.replaceChildren(
        shape("defs", {}, shape("clipPath", { id: clip }, shape("rect", box))),
        shape("rect", { ...box, fill: "var(--ground)" }), frame, layer, shape("rect", { ...box, fill: "none", stroke: "var(--frame)" }), this.over);
      options.draw(layer, this);
      this.mark(this.marked);
    }

    equalise() {
      const scale = Math.max((this.x[1] - this.x[0]) / this.inner, (this.y[1] - this.y[0]) / this.tall);
      const around = ([low, high], span) => [(low + high - span) / 2, (low + high + span) / 2];
      this.x = around(this.x, scale * this.inner);
      this.y = around(this.y, scale * this.tall);
    }

    /* Pixels of the drawing under a pointer, whatever size the page shows it in. */
    at(event) {
      const box = this.svg.getBoundingClientRect();
      const ratio = this.svg.viewBox.baseVal.width / box.width;
      return [(event.clientX - box.left) * ratio, (event.clientY - box.top) * ratio];
    }

    press(event) {
      if (event.button !== 0) return;
      this.drag = { from: this.at(event), to: this.at(event) };
      this.svg.setPointerCapture(event.pointerId);
      this.tip.hidden = true;
    }

    move(event) {
      const [px, py] = this.at(event);
      if (!this.drag) return this.point([px, py]);
      this.drag.to = [px, py];
      const [x1, x2, y1, y2] = this.dragged();
      this.over.replaceChildren(shape("rect", { x: x1, y: y1, width: x2 - x1, height: y2 - y1, fill: "var(--ink)", "fill-opacity": 0.08, stroke: "var(--ink)" }));
    }

    dragged() {
      const { from, to } = this.drag;
      const [x1, x2] = [from[0], to[0]].map((v) => between(v, this.left, this.left + this.inner)).sort((a, b) => a - b);
      const ends = this.options.zoom === "x" ? [this.top, this.top + this.tall] : [from[1], to[1]];
      const [y1, y2] = ends.map((v) => between(v, this.top, this.top + this.tall)).sort((a, b) => a - b);
      return [x1, x2, y1, y2];
    }

    release(event) {
      if (!this.drag) return;
      const [x1, x2, y1, y2] = this.dragged();
      this.abandon();
      if (x2 - x1 > 6 && y2 - y1 > 6) this.show({ x: [this.ix(x1), this.ix(x2)], y: [this.iy(y2), this.iy(y1)] });
      else this.point(this.at(event));
    }

    abandon() {
      this.drag = null;
      this.mark(this.marked);
    }

    scale(factor, about = null) {
      const part = (values, center) => values.map((value) => center + (value - center) * factor);
      const [cx, cy] = about || [(this.x[0] + this.x[1]) / 2, (this.y[0] + this.y[1]) / 2];
      this.show({ x: part(this.x, cx), y: this.options.zoom === "x" ? this.y : part(this.y, cy) });
    }

    pan(across, up) {
      const [w, h] = [this.x[1] - this.x[0], this.y[1] - this.y[0]];
      this.show({ x: this.x.map((v) => v + across * w), y: this.y.map((v) => v + (this.options.zoom === "x" ? 0 : up * h)) });
    }

    wheel(event) {
      if (!event.ctrlKey && !event.metaKey) return; // the wheel alone scrolls the page
      event.preventDefault();
      const [px, py] = this.at(event);
      this.scale(Math.exp(0.002 * event.deltaY), [this.ix(px), this.iy(py)]);
    }

    key(event) {
      const run = {
        "+": () => this.scale(0.6), "=": () => this.scale(0.6), "-": () => this.scale(1 / 0.6), 0: () => this.show(null), Escape: () => this.show(null),
        ArrowLeft: () => this.pan(-0.2, 0), ArrowRight: () => this.pan(0.2, 0), ArrowUp: () => this.pan(0, 0.2), ArrowDown: () => this.pan(0, -0.2),
      }[event.key];
      if (!run || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      run();
    }

    /* Show a part, {x, y}, or everything for null. */
    show(view) {
      const limit = this.options.limit && this.options.limit();
      if (view && limit) {
        const x = [Math.max(view.x[0], limit.x[0]), Math.min(view.x[1], limit.x[1])];
        view = x[1] - x[0] >= limit.x[1] - limit.x[0] || x[1] <= x[0] ? null : { ...view, x };
      }
      this.view = view;
      this.tip.hidden = true;
      if (this.options.zoomed) this.options.zoomed(view);
      this.redraw();
    }

    point(pixel) {
      const inside = pixel && pixel[0] >= this.left && pixel[0] <= this.left + this.inner && pixel[1] >= this.top && pixel[1] <= this.top + this.tall;
      const found = inside ? this.options.hover(this.ix(pixel[0]), this.iy(pixel[1]), this) : null;
      this.tip.hidden = !found;
      if (!found) return void (this.options.gone && this.options.gone());
      this.tip.textContent = found.lines.join("\n");
      const shown = this.svg.clientWidth / this.svg.viewBox.baseVal.width;
      const [px, py] = [this.sx(found.x) * shown, this.sy(found.y) * shown];
      const [w, h] = [this.tip.offsetWidth, this.tip.offsetHeight];
      this.tip.style.left = `${between(px + 14 + w > this.host.clientWidth ? px - w - 14 : px + 14, 0, Math.max(0, this.host.clientWidth - w))}px`;
      this.tip.style.top = `${between(py - h / 2, 0, Math.max(0, this.host.clientHeight - h))}px`;
    }

    /* Mark a point, or a moment when y is null; nothing for x null. A moment stays when the chart is drawn anew. */
    mark(x, y = null) {
      this.marked = y === null ? x : null;
      if (!this.over || this.drag) return;
      if (x === null || !Number.isFinite(x)) return this.over.replaceChildren();
      const at = this.sx(x);
      this.over.replaceChildren(y === null
        ? shape("line", { x1: at, x2: at, y1: this.top, y2: this.top + this.tall, stroke: "var(--ink)", "stroke-dasharray": "3 3" })
        : shape("circle", { cx: at, cy: this.sy(y), r: 6, fill: "none", stroke: "var(--ink)", "stroke-width": 2 }));
    }
  }

  /* A path through points; null breaks it. */
  function path(points) {
    let text = "";
    let pen = "M";
    for (const point of points) {
      if (!point) { pen = "M"; continue; }
      text += `${pen}${point[0].toFixed(1)} ${point[1].toFixed(1)}`;
      pen = "L";
    }
    return text;
  }

  /* Blue over pale to red, told apart by all kinds of colour vision; share from -1 to 1. */
  const BRIGHT = [[33, 102, 172], [103, 169, 207], [224, 226, 230], [239, 138, 98], [178, 24, 43]];
  const DIM = [[120, 190, 255], [62, 118, 168], [52, 56, 66], [176, 84, 52], [255, 128, 108]];
  let printing = false;
  function diverging(share) {
    const STOPS = scheme.matches && !printing ? DIM : BRIGHT;
    const place = (between(share, -1, 1) + 1) * 2;
    const k = Math.min(3, Math.floor(place));
    const mixed = STOPS[k].map((low, c) => Math.round(low + (STOPS[k + 1][c] - low) * (place - k)));
    return `rgb(${mixed.join(",")})`;
  }

  function redrawAll() { all.forEach((plot) => plot.redraw()); }
  let waiting = 0;
  window.addEventListener("resize", () => { cancelAnimationFrame(waiting); waiting = requestAnimationFrame(redrawAll); });
  window.addEventListener("beforeprint", () => { paperWidth = 690; printing = true; redrawAll(); });
  window.addEventListener("afterprint", () => { paperWidth = null; printing = false; redrawAll(); });
  scheme.addEventListener("change", redrawAll);

  return { Plot, shape, element, path, diverging, fixed, short, between, unpack, csv };
})();
