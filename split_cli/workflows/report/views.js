/* Charts told by numbers alone: lines, points, bars and bands, series that can be switched off, two kinds of x. */
(() => {
  const { Plot, shape, element, path, short, between, unpack, csv } = Charts;
  const charts = JSON.parse(document.getElementById("numbers").textContent).charts || [];
  /* Dots let others through only where their colour bears it: `DOTS` of the palette. */
  const DOTS = { measured: 0.5 };
  const DASHES = { nominal: "6 3", corrected: "10 3", other: "2 3" };
  const plots = {};
  const choice = document.getElementById("along");
  let along = Boolean(choice && choice.querySelector("[value=s]").checked); // whether charts with two kinds of x show the other one

  function spread(lists, margin = 0.04, least = 0) {
    let [low, high] = [Infinity, -Infinity];
    for (const list of lists) for (const v of list) if (Number.isFinite(v)) { if (v < low) low = v; if (v > high) high = v; }
    if (!(high >= low)) return [0, 1];
    const own = high > low ? margin * (high - low) : least ? 0 : Math.abs(high) * 0.1 || 0.5;
    const more = Math.max(own, (least - (high - low)) / 2);
    return [low - more, high + more];
  }

  function chart(spec) {
    const host = document.querySelector(`#chart-${spec.name} .canvas`);
    if (!host) return;
    const series = spec.series.map((one) => ({
      ...one, x: unpack(one.x), y: unpack(one.y), low: one.low && unpack(one.low), high: one.high && unpack(one.high), along: one.along && unpack(one.along), color: `var(--${one.role})`,
    }));
    const visible = () => series.filter((one) => one.shown);
    const across = (one) => (along && one.along ? one.along : one.x);
    const rows = spec.rows.length ? spec.rows : null;
    const strips = Boolean(spec.other_x);

    function reach(view) {
      const lists = visible();
      if (rows) {
        const ends = lists.flatMap((one) => [one.x, one.low || [], one.high || []]);
        const zero = lists.some((one) => one.kind === "bars") ? [[0]] : [];
        const at = spec.reference === null ? [] : [[spec.reference]];
        return { x: view ? view.x : spread([...ends, ...zero, ...at], 0.04, spec.least_span), y: [-0.6, rows.length - 0.4] };
      }
      if (view && !strips) return view;
      const x = view ? view.x : spread(lists.map(across), strips ? 0 : 0.04);
      const inside = lists.flatMap((one) => {
        const at = across(one);
        const kept = (values) => values.filter((_, i) => at[i] >= x[0] && at[i] <= x[1]);
        return [kept(one.y), ...(one.low ? [kept(one.low), kept(one.high)] : [])];
      });
      const bands = spec.bands.map((band) => [band.low, band.high]);
      return { x, y: spread([...inside, ...bands], 0.06) };
    }

    function drawRows(layer, plot) {
      const shown = visible();
      if (spec.reference !== null) layer.append(shape("line", { x1: plot.sx(spec.reference), x2: plot.sx(spec.reference), y1: plot.top, y2: plot.top + plot.tall, stroke: "var(--soft)", "stroke-dasharray": "4 3" }));
      const thick = Math.min(16, (plot.tall / rows.length / Math.max(shown.length, 1)) * 0.62);
      const step = (plot.tall / rows.length) * 0.78 / Math.max(shown.length, 1);
      shown.forEach((one, k) => one.y.forEach((row, i) => {
        if (!Number.isFinite(one.x[i])) return;
        const y = plot.sy(rows.length - 1 - row) + (k - (shown.length - 1) / 2) * step;
        const [from, to] = [plot.sx(0), plot.sx(one.x[i])];
        if (one.kind === "bars") layer.append(shape("rect", { x: Math.min(from, to), y: y - thick / 2, width: Math.max(Math.abs(to - from), 1), height: thick, fill: one.color, "fill-opacity": one.emphasis[i] ? 1 : 0.45 }));
        else layer.append(shape("circle", { cx: to, cy: y, r: one.emphasis[i] ? 6 : 4.5, fill: one.color, stroke: "var(--ground)" }));
        if (one.low && Number.isFinite(one.low[i])) {
          const [a, b] = [plot.sx(one.low[i]), plot.sx(one.high[i])];
          layer.append(shape("path", { d: `M${a} ${y}H${b}M${a} ${y - 4}V${y + 4}M${b} ${y - 4}V${y + 4}`, stroke: "var(--ink)", "stroke-width": 1.3, fill: "none" }));
        }
        if (!one.emphasis[i]) return;
        const [first, last] = one.low && Number.isFinite(one.low[i]) ? [plot.sx(one.low[i]), plot.sx(one.high[i])] : [to, to];
        const outside = Math.max(to, last) + 6;
        // Where the frame leaves no room beside the whisker, the word stands on the bar.
        const fits = outside + 32 <= plot.left + plot.inner || one.kind !== "bars";
        layer.append(fits
          ? shape("text", { class: "best", x: outside, y: y + 4 }, "best")
          : shape("text", { class: "best inside", x: Math.min(to, first) - 6, y: y + 4, "text-anchor": "end" }, "best"));
      }));
    }

    function draw(layer, plot) {
      for (const band of spec.bands) {
        const [top, low] = [plot.sy(band.high), plot.sy(band.low)];
        layer.append(shape("rect", { x: plot.left, y: top, width: plot.inner, height: Math.max(low - top, 1), fill: "var(--noise)" }));
      }
      if (rows) return drawRows(layer, plot);
      if (plot.y[0] < 0 && plot.y[1] > 0) layer.append(shape("line", { x1: plot.left, x2: plot.left + plot.inner, y1: plot.sy(0), y2: plot.sy(0), stroke: "var(--frame)" }));
      const point = (x, y) => (Number.isFinite(x) && Number.isFinite(y) ? [plot.sx(x), plot.sy(y)] : null);
      // Dots below lines, and those that let others through above them.
      const depth = (one) => (one.kind !== "points" ? 2 : one.role in DOTS ? 1 : 0);
      const order = [...visible()].sort((a, b) => depth(a) - depth(b));
      for (const one of order) {
        const x = across(one);
        if (one.kind === "points") {
          let dots = "";
          one.y.forEach((y, i) => { const at = point(x[i], y); if (at) dots += `M${at[0].toFixed(1)} ${at[1].toFixed(1)}h0`; });
          layer.append(shape("path", { d: dots, fill: "none", stroke: one.color, "stroke-opacity": DOTS[one.role] || 1, "stroke-width": 3.2, "stroke-linecap": "round" }));
          continue;
        }
        if (one.low) {
          const runs = [[]];  // where there is no band, it breaks as the line does
          one.y.forEach((_, i) => {
            const ends = [point(x[i], one.high[i]), point(x[i], one.low[i])];
            if (ends.every(Boolean)) runs[runs.length - 1].push(ends);
            else runs.push([]);
          });
          const edge = runs.filter((run) => run.length).map((run) => `${path([...run.map((ends) => ends[0]), ...run.reverse().map((ends) => ends[1])])}Z`).join("");
          if (edge) layer.append(shape("path", { d: edge, fill: one.color, "fill-opacity": 0.2 }));
        }
        const points = Array.from(one.y, (y, i) => point(x[i], y));
        layer.append(shape("path", { d: path(points), fill: "none", stroke: one.color, "stroke-width": one.role === "measured" ? 1.7 : 1.9, "stroke-linejoin": "round", "stroke-dasharray": DASHES[one.role] || "none" }));
        if (points.length <= 40) for (const at of points) if (at) layer.append(shape("circle", { cx: at[0], cy: at[1], r: 2.6, fill: one.color }));
      }
    }

    function hover(x, y, plot) {
      if (rows) {
        const row = rows.length - 1 - Math.round(y);
        const lines = visible().flatMap((one) => Array.from(one.y.keys()).filter((i) => one.y[i] === row && Number.isFinite(one.x[i])).map((i) => {
          const ends = one.low && Number.isFinite(one.low[i]) ? ` (95 %: ${short(one.low[i])} to ${short(one.high[i])})` : "";
          return `${one.name}: ${short(one.x[i])}${ends}`;
        }));
        return lines.length ? { x: between(x, ...plot.x), y: Math.round(y), lines: [rows[row], ...lines] } : null;
      }
      const lines = [];
      let mark = null;
      let best = Infinity;
      for (const one of visible()) {
        const at = across(one);
        let [near, far] = [-1, Infinity];
        for (let i = 0; i < at.length; i++) {
          const dx = (plot.sx(at[i]) - plot.sx(x)) / plot.inner;
          const dy = one.kind === "points" || spec.equal ? (plot.sy(one.y[i]) - plot.sy(y)) / plot.tall : 0;
          const off = dx * dx + dy * dy;
          if (off < far) [near, far] = [i, off];
        }
        if (near < 0 || far > 0.003) continue;
        const ends = one.low ? ` (95 %: ${short(one.low[near])} to ${short(one.high[near])})` : "";
        lines.push(`${one.name}: ${short(one.y[near])}${ends}`);
        const off = Math.abs(plot.sy(one.y[near]) - plot.sy(y));
        if (off < best) [best, mark] = [off, { x: at[near], y: one.y[near] }];
      }
      if (!mark || !Number.isFinite(mark.y)) return null;
      return { x: mark.x, y: between(mark.y, ...plot.y), lines: [`${along && strips ? spec.other_x : spec.x}: ${short(mark.x)}`, ...lines] };
    }

    const plot = new Plot(host, {
      name: spec.name,
      zoom: strips || rows ? "x" : "xy",
      equal: spec.equal,
      digits: strips ? 6 : 0, // one moment stands at one place in all strips
      rows,
      height: (width, paper) => (rows ? 62 + Math.max(paper ? 20 : 26, (paper ? 10 : 20) * visible().length) * rows.length : paper ? (spec.wide ? 120 : 166) : spec.wide ? between(0.24 * width, 170, 250) : between(0.74 * width, 220, spec.equal ? 430 : 330)),
      x: () => (along && strips ? spec.other_x : spec.x),
      y: () => spec.y,
      label: () => `${spec.title}: ${visible().map((one) => one.name).join(", ")}.`,
      domain: reach,
      limit: () => (rows ? null : { x: reach(null).x }),
      draw, hover,
      keys: () => visible().map(({ color, name }) => ({ color, text: name })),
      csv: () => csv([["series", spec.x, spec.other_x || "-", spec.y || "row", "low", "high"], ...series.flatMap((one) => Array.from(one.x, (x, i) => [
        one.name, x, one.along ? one.along[i] : "", rows ? rows[one.y[i]] : one.y[i], one.low ? one.low[i] : "", one.high ? one.high[i] : ""]))]),
      zoomed(view) {
        if (!spec.group) return;
        for (const other of Object.values(plots)) {
          if (other === plot || other.group !== spec.group) continue;
          other.view = view && { x: view.x, y: other.y };
          if (other.group !== "strips" && view) other.view.y = other.options.domain(null).y;
          other.redraw();
        }
      },
    });
    plot.group = spec.group;
    plots[spec.name] = plot;
    legend(host.parentElement.querySelector(".legend"), series, spec, plot);
    plot.redraw();
  }

  /* One switch a series; a chart with one series has a name, not a switch. */
  function legend(place, series, spec, plot) {
    if (!place) return;
    // The axis of a single row of bars says what they are.
    const drawn = series.length === 1 && series[0].kind === "bars" ? [] : series;
    const parts = drawn.map((one) => {
      const mark = one.kind === "points"
        ? shape("circle", { cx: 11, cy: 6, r: 4, fill: one.color, "fill-opacity": spec.rows.length ? 1 : DOTS[one.role] || 1 })
        : shape("line", { x1: 0, x2: 22, y1: 6, y2: 6, stroke: one.color, "stroke-width": one.kind === "bars" ? 8 : 3, "stroke-dasharray": DASHES[one.role] || "none" });
      const inside = [shape("svg", { width: 22, height: 12, "aria-hidden": "true" }, mark), one.name];
      if (series.length < 2) return element("span", { class: "key" }, ...inside);
      const button = element("button", { type: "button", class: "key switch", "aria-pressed": String(one.shown) }, ...inside);
      button.addEventListener("click", () => {
        one.shown = !one.shown;
        button.setAttribute("aria-pressed", String(one.shown));
        plot.redraw();
      });
      return button;
    });
    const bands = spec.bands.map((band) => element("span", { class: "key" }, shape("svg", { width: 22, height: 12, "aria-hidden": "true" }, shape("rect", { width: 22, height: 12, fill: "var(--noise)" })), band.name));
    place.replaceChildren(...parts, ...bands);
    // On paper a row of charts with one legend shows it once.
    const before = place.closest("figure")?.previousElementSibling?.querySelector(".legend");
    place.classList.toggle("same", Boolean(before) && before.textContent === place.textContent);
  }

  charts.forEach(chart);
  /* Mark a moment and a place in charts with two kinds of x; null for none. */
  let marked = [null, null];
  Charts.markStrips = (time, place) => {
    marked = [time, place];
    for (const plot of Object.values(plots)) if (plot.group === "strips") plot.mark(along ? place : time);
  };
  if (choice) choice.addEventListener("change", (event) => {
    along = event.target.value === "s";
    for (const plot of Object.values(plots)) if (plot.group === "strips") { plot.view = null; plot.redraw(); }
    Charts.markStrips(...marked);
  });
})();
