/* Where a gap is: over operating points, along the track and over the drive, with the controls that change it. */
(() => {
  const { Plot, shape, element, path, diverging, fixed, short, between, unpack, csv } = Charts;
  const numbers = JSON.parse(document.getElementById("numbers").textContent);
  const BEFORE = "var(--simulated)";
  const AFTER = "var(--corrected)";
  const AXES = [
    ["alpha_f", "alpha_r", "front \u00d7 rear slip angle"],
    ["alpha_f", "torque", "front slip angle \u00d7 torque"],
    ["alpha_r", "torque", "rear slip angle \u00d7 torque"],
    ["speed", "torque", "speed \u00d7 torque"],
  ];
  const TITLES = {
    alpha_f: "front slip angle [rad]", alpha_r: "rear slip angle [rad]", torque: "torque / largest drive torque", speed: "speed [m/s]",
    t: "time [s]", s: "track position s [m]",
  };
  const SHADES = 15;
  const SAME_SAYING = 5; // neighbouring samples share an average over 0.2 s: so many count as one

  const drives = numbers.drives.map((drive) => {
    const out = { ...drive, before: drive.before.map(unpack), after: drive.after.map(unpack), smooth: {} };
    for (const name of ["t", "s", "x", "y", "alpha_f", "alpha_r", "torque", "speed"]) out[name] = unpack(drive[name]);
    out.size = out.t.length;
    return out;
  });
  const gap = numbers.verdict === "mismatch";
  const located = numbers.location || { channel: 0, time: null, place: null };
  const state = { channel: located.channel, stage: gap ? "before" : "compared", axes: gap ? [3, 1, 2][located.channel] : 0, drive: -1, along: "t", seconds: 0.2, window: null };

  const chosenDrives = () => (state.drive < 0 ? drives : [drives[state.drive]]);
  const forceName = () => numbers.forces[state.channel].toLowerCase();
  const averaged = () => `averaged over ${state.seconds} s`;
  const unit = (value, step) => `${fixed(value, step)} N`;

  /* Gap forces of a drive, averaged over a centred window that does not cross gaps. */
  function smoothed(drive, stage) {
    const key = `${stage} ${state.channel} ${state.seconds}`;
    if (drive.smooth[key]) return drive.smooth[key];
    const raw = drive[stage][state.channel];
    const half = Math.floor(state.seconds / drive.step / 2);
    const total = new Float64Array(drive.size + 1);
    for (let i = 0; i < drive.size; i++) total[i + 1] = total[i] + raw[i];
    const out = new Float64Array(drive.size);
    drive.run.forEach((begin, k) => {
      const end = k + 1 < drive.run.length ? drive.run[k + 1] : drive.size;
      for (let i = begin; i < end; i++) {
        const [low, high] = [Math.max(begin, i - half), Math.min(end, i + half + 1)];
        out[i] = (total[high] - total[low]) / (high - low);
      }
    });
    return (drive.smooth[key] = out);
  }

  function inWindow(drive, i) {
    if (!state.window) return true;
    const value = drive[state.along][i];
    return value >= state.window[0] && value <= state.window[1];
  }

  function extent(columns, share = 0) {
    const all = [];
    for (const column of columns) for (const value of column) if (Number.isFinite(value)) all.push(value);
    if (!all.length) return [0, 1];
    all.sort((a, b) => a - b);
    const [low, high] = [all[Math.floor(share * (all.length - 1))], all[Math.ceil((1 - share) * (all.length - 1))]];
    const margin = 0.04 * (high - low) || 0.5;
    return [low - margin, high + margin];
  }

  function largest(values, share = 0.98) {
    const sizes = values.filter(Number.isFinite).map(Math.abs).sort((a, b) => a - b);
    return sizes.length ? sizes[Math.floor(share * (sizes.length - 1))] || 1e-9 : 1;
  }

  function key(color, text, dashed = false) {
    const line = shape("line", { x1: 0, x2: 22, y1: 6, y2: 6, stroke: color, "stroke-width": 3, "stroke-dasharray": dashed ? "4 3" : "none" });
    return element("span", { class: "key" }, shape("svg", { width: 22, height: 12, "aria-hidden": "true" }, line), text);
  }

  function scaleLegend(limit, note) {
    const bar = shape("svg", { width: 130, height: 12, "aria-hidden": "true" });
    for (let k = 0; k < 26; k++) bar.append(shape("rect", { x: 5 * k, y: 0, width: 5.5, height: 12, fill: diverging((k - 12.5) / 12.5) }));
    return [element("span", { class: "key" }, `\u2212${short(limit)}`, bar, `+${short(limit)} N`), element("span", {}, note)];
  }

  /* ---- over operating points ---- */
  let cells = [];
  function binned(plot) {
    const [xName, yName] = AXES[state.axes];
    document.querySelector("#plot-map .hint").hidden = yName !== "torque";
    // Fewer samples make larger cells, so that most have enough for a mean. The screen does not decide: means,
    // colours and the table are the same on paper and on a telephone.
    const samples = chosenDrives().reduce((sum, drive) => sum + drive.size, 0);
    const fine = between((samples / 6000) ** 0.25, 0.53, 1);
    const [across, up] = [Math.round(28 * fine), Math.round(20 * fine)];
    const [w, h] = [(plot.x[1] - plot.x[0]) / across, (plot.y[1] - plot.y[0]) / up];
    const found = new Map();
    for (const drive of chosenDrives()) {
      const stages = ["before", "after"].map((stage) => drive[stage][state.channel]);
      for (let i = 0; i < drive.size; i++) {
        if (!inWindow(drive, i)) continue;
        const [a, b] = [Math.floor((drive[xName][i] - plot.x[0]) / w), Math.floor((drive[yName][i] - plot.y[0]) / h)];
        if (!(a >= 0 && a < across && b >= 0 && b < up)) continue;
        const id = a * up + b;
        if (!found.has(id)) found.set(id, { a, b, all: 0, compared: 0, sum: [0, 0], square: [0, 0] });
        const cell = found.get(id);
        cell.all += 1;
        if (!drive.compared[i]) continue;
        cell.compared += 1;
        stages.forEach((values, k) => { cell.sum[k] += values[i]; cell.square[k] += values[i] ** 2; });
      }
    }
    for (const cell of found.values()) {
      const n = Math.max(cell.compared, 1);
      cell.mean = cell.sum.map((sum) => sum / n);
      cell.error = cell.square.map((square, k) => Math.sqrt(Math.max(square / n - cell.mean[k] ** 2, 0) / Math.max(n / SAME_SAYING, 1)));
      Object.assign(cell, { x: plot.x[0] + (cell.a + 0.5) * w, y: plot.y[0] + (cell.b + 0.5) * h, w, h });
    }
    return [...found.values()];
  }

  const map = {
    host: "map",
    options: {
      name: "operating-points",
      csv: () => csv([[TITLES[AXES[state.axes][0]], TITLES[AXES[state.axes][1]], "mean gap force [N]", "with effects [N]", "compared", "samples"],
        ...cells.map((cell) => [cell.x, cell.y, cell.mean[0], cell.mean[1], cell.compared, cell.all])]),
      zoom: "xy",
      height: (width, paper) => (paper ? 220 : between(0.78 * width, 240, 430)),
      x: () => TITLES[AXES[state.axes][0]],
      y: () => TITLES[AXES[state.axes][1]],
      label: () => `Map over ${AXES[state.axes][2]}, coloured by ${state.stage === "compared" ? "samples compared" : `mean ${forceName()} gap force`}.`,
      domain: (view) => view || {
        x: extent(chosenDrives().map((drive) => drive[AXES[state.axes][0]]), 0.002),
        y: extent(chosenDrives().map((drive) => drive[AXES[state.axes][1]]), 0.002),
      },
      draw(layer, plot) {
        cells = binned(plot);
        const judged = cells.filter((cell) => cell.compared >= 3);
        const limit = largest(judged.map((cell) => cell.mean[0]));
        const most = Math.max(1, ...cells.map((cell) => cell.compared));
        const stage = state.stage === "after" ? 1 : 0;
        for (const cell of cells) {
          const [px, py] = [plot.sx(cell.x - cell.w / 2), plot.sy(cell.y + cell.h / 2)];
          const size = { width: plot.sx(cell.x + cell.w / 2) - px, height: plot.sy(cell.y - cell.h / 2) - py };
          if (cell.compared < 3 && !(state.stage === "compared" && cell.compared)) {
            layer.append(shape("rect", { x: px + 2, y: py + 2, width: size.width - 4, height: size.height - 4, fill: "none", stroke: "var(--faint)" }));
          } else if (state.stage === "compared") {
            const depth = Math.log1p(cell.compared) / Math.log1p(most);
            layer.append(shape("rect", { x: px, y: py, ...size, fill: "var(--simulated)", "fill-opacity": (0.12 + 0.83 * depth).toFixed(2), stroke: "var(--ground)", "stroke-width": 0.5 }));
          } else {
            // What could as well be noise is drawn small.
            const inset = Math.abs(cell.mean[stage]) > 2 * cell.error[stage] ? 0 : 0.29;
            layer.append(shape("rect", {
              x: px + inset * size.width, y: py + inset * size.height, width: (1 - 2 * inset) * size.width, height: (1 - 2 * inset) * size.height,
              fill: diverging(cell.mean[stage] / limit), stroke: "var(--ground)", "stroke-width": 0.5,
            }));
          }
        }
        legend("map", ...(state.stage === "compared"
          ? [key("var(--simulated)", `compared, up to ${most} samples a cell`), key("var(--faint)", "only real")]
          : scaleLegend(limit, "mean of a cell; small squares: within 2 standard errors of 0; outlined: too few samples to compare")));
      },
      hover(x, y, plot) {
        const cell = cells.find((one) => Math.abs(one.x - x) <= one.w / 2 && Math.abs(one.y - y) <= one.h / 2);
        if (!cell) return null;
        const lines = [`${TITLES[AXES[state.axes][0]]}: ${short(cell.x)}`, `${TITLES[AXES[state.axes][1]]}: ${short(cell.y)}`];
        if (gap && cell.compared) {
          const force = (k) => `${unit(cell.mean[k], cell.error[k] || 1)} \u00b1 ${short(cell.error[k])}`;
          lines.push(`gap: ${force(0)}`);
          if (numbers.named) lines.push(`with the physics: ${force(1)}`);
        }
        lines.push(`${cell.compared} of ${cell.all} samples compared`);
        return { x: cell.x, y: cell.y, lines };
      },
    },
  };

  /* ---- along the track ---- */
  const placed = drives.some((drive) => drive.x.some(Number.isFinite));
  const trackX = (drive) => (placed ? drive.x : drive.s);
  const trackY = (drive) => (placed ? drive.y : smoothed(drive, state.stage === "after" ? "after" : "before"));
  const inPlace = (s) => located.place && (located.place[0] <= located.place[1]
    ? s >= located.place[0] && s <= located.place[1] : s >= located.place[0] || s <= located.place[1]);

  const track = {
    host: "track",
    options: {
      name: "gap-along-the-track",
      csv: () => csv([["drive", "t [s]", "s [m]", "X [m]", "Y [m]", "gap force [N]", "with effects [N]", "compared"],
        ...chosenDrives().flatMap((drive) => Array.from(drive.t, (t, i) => [drive.name, t, drive.s[i], drive.x[i], drive.y[i], smoothed(drive, "before")[i], smoothed(drive, "after")[i], drive.compared[i]]))]),
      zoom: "xy",
      equal: placed,
      height: (width, paper) => (paper ? 220 : between(0.78 * width, 240, 430)),
      x: () => (placed ? "X [m]" : TITLES.s),
      y: () => (placed ? "Y [m]" : "gap force [N]"),
      label: () => `Track map, coloured by ${state.stage === "compared" ? "what was compared" : `${forceName()} gap force`}.`,
      domain: (view) => view || { x: extent(chosenDrives().map(trackX)), y: extent(chosenDrives().map(trackY)) },
      draw(layer, plot) {
        const values = chosenDrives().map((drive) => smoothed(drive, "before"));
        const limit = largest(values.flatMap((column) => [...column]));
        const shades = Array.from({ length: SHADES + 1 }, () => []);
        const halo = [];
        for (const drive of chosenDrives()) {
          const [xs, ys, force] = [trackX(drive), trackY(drive), smoothed(drive, state.stage === "after" ? "after" : "before")];
          const begins = new Set(drive.run);
          for (let i = 1; i < drive.size; i++) {
            if (begins.has(i) || !inWindow(drive, i) || !Number.isFinite(xs[i] + xs[i - 1]) || (!placed && xs[i] < xs[i - 1])) continue;
            const piece = [[plot.sx(xs[i - 1]), plot.sy(ys[i - 1])], [plot.sx(xs[i]), plot.sy(ys[i])], null];
            const shade = state.stage === "compared" ? SHADES - 1 : Math.round(((between(force[i] / limit, -1, 1) + 1) / 2) * (SHADES - 1));
            shades[drive.compared[i] ? shade : SHADES].push(...piece);
            if (inPlace(drive.s[i])) halo.push(...piece);
          }
        }
        const stroke = (points, color, width) => layer.append(shape("path", { d: path(points), fill: "none", stroke: color, "stroke-width": width, "stroke-linecap": "round" }));
        if (halo.length) stroke(halo, "var(--halo)", 13);
        stroke(shades[SHADES], "var(--faint)", 1.2);
        // The pale middle first, so that what stands out lies on top.
        const order = Array.from({ length: SHADES }, (_, k) => k).sort((a, b) => Math.abs(a - (SHADES - 1) / 2) - Math.abs(b - (SHADES - 1) / 2));
        for (const k of order) if (shades[k].length) stroke(shades[k], state.stage === "compared" ? BEFORE : diverging((2 * k) / (SHADES - 1) - 1), 4.5);
        const marks = located.place ? [key("var(--halo)", "where the gap stands out")] : [];
        const thin = chosenDrives().some((drive) => drive.compared.includes(0)) ? [key("var(--faint)", "not compared")] : [];
        legend("track", ...(state.stage === "compared" ? [key(BEFORE, "compared")] : scaleLegend(limit, averaged())), ...thin, ...marks);
      },
      hover(x, y, plot) {
        return nearest((drive, i) => {
          const [px, py] = [plot.sx(trackX(drive)[i]) - plot.sx(x), plot.sy(trackY(drive)[i]) - plot.sy(y)];
          return inWindow(drive, i) ? px * px + py * py : Infinity;
        }, 900, (drive, i) => [trackX(drive)[i], trackY(drive)[i]]);
      },
      gone: () => link(null),
    },
  };

  /* ---- over the drive ---- */
  const strip = {
    host: "strip",
    options: {
      name: "gap-over-the-drive",
      csv: () => csv([["drive", "t [s]", "s [m]", "X [m]", "Y [m]", "gap force [N]", "with effects [N]", "compared"],
        ...chosenDrives().flatMap((drive) => Array.from(drive.t, (t, i) => [drive.name, t, drive.s[i], drive.x[i], drive.y[i], smoothed(drive, "before")[i], smoothed(drive, "after")[i], drive.compared[i]]))]),
      zoom: "x",
      height: (width, paper) => (paper ? 170 : between(0.3 * width, 210, 320)),
      x: () => TITLES[state.along],
      y: () => "gap force [N]",
      label: () => `${numbers.forces[state.channel]} gap force over ${TITLES[state.along]}, before and after the identified effects.`,
      limit: () => ({ x: extent(chosenDrives().map((drive) => drive[state.along])) }),
      domain(view) {
        const x = view ? view.x : extent(chosenDrives().map((drive) => drive[state.along]));
        const stages = numbers.named ? ["before", "after"] : ["before"];
        const inside = chosenDrives().flatMap((drive) => stages.map((stage) => smoothed(drive, stage).filter((_, i) => drive[state.along][i] >= x[0] && drive[state.along][i] <= x[1])));
        const y = extent(inside, 0.0005);
        return { x, y: [Math.min(y[0], 0), Math.max(y[1], 0)] };
      },
      zoomed(view) {
        state.window = view && view.x;
        for (const other of [charts.map, charts.track]) if (other) other.redraw();
      },
      draw(layer, plot) {
        const band = (from, to, color) => layer.append(shape("rect", {
          x: plot.sx(from), y: plot.top, width: Math.max(plot.sx(to) - plot.sx(from), 1), height: plot.tall, fill: color,
        }));
        if (state.along === "t" && located.time) band(...located.time, "var(--mark)");
        if (state.along === "s" && located.place) {
          const [from, to] = located.place;
          if (from <= to) band(from, to, "var(--mark)");
          else { band(plot.x[0], to, "var(--mark)"); band(from, plot.x[1], "var(--mark)"); }
        }
        layer.append(shape("line", { x1: plot.left, x2: plot.left + plot.inner, y1: plot.sy(0), y2: plot.sy(0), stroke: "var(--soft)" }));
        const stages = numbers.named ? [["before", BEFORE], ["after", AFTER]] : [["before", BEFORE]];
        for (const drive of chosenDrives()) {
          const x = drive[state.along];
          const begins = new Set(drive.run);
          for (const [stage, color] of stages) {
            const values = smoothed(drive, stage);
            const lines = { true: [], false: [] };
            for (let i = 0; i < drive.size; i++) {
              const point = [plot.sx(x[i]), plot.sy(values[i])];
              const compared = Boolean(drive.compared[i]);
              if (begins.has(i) || x[i] < x[i - 1]) { lines.true.push(null); lines.false.push(null); }
              lines[compared].push(point);
              lines[!compared].push(null);
            }
            layer.append(shape("path", { d: path(lines.false), fill: "none", stroke: "var(--faint)" }));
            layer.append(shape("path", { d: path(lines.true), fill: "none", stroke: color, "stroke-width": stage === "after" ? 1.3 : 1.6, "stroke-linejoin": "round" }));
          }
        }
        const keys = [key(BEFORE, "gap: reality less simulation")];
        if (numbers.named) keys.push(key(AFTER, "residual with the identified effects"));
        if (chosenDrives().some((drive) => drive.compared.includes(0))) keys.push(key("var(--faint)", "not compared"));
        legend("strip", ...keys, element("span", {}, averaged()));
      },
      hover(x, y, plot) {
        const reach = plot.x[1] - plot.x[0];
        return nearest((drive, i) => {
          const across = Math.abs(drive[state.along][i] - x) / reach;
          const up = Math.abs(smoothed(drive, "before")[i] - y) / (plot.y[1] - plot.y[0]);
          return across + 0.002 * up; // several laps share an s: the closer line wins
        }, 0.03, (drive, i) => [drive[state.along][i], smoothed(drive, "before")[i]]);
      },
      gone: () => link(null),
    },
  };

  function nearest(distance, within, position) {
    let best = within;
    let found = null;
    for (const drive of chosenDrives()) {
      for (let i = 0; i < drive.size; i++) {
        const far = distance(drive, i);
        if (far < best) [best, found] = [far, [drive, i]];
      }
    }
    link(found);
    if (!found) return null;
    const [drive, i] = found;
    const lines = [`t ${fixed(drive.t[i], 0.01)} s \u00b7 s ${fixed(drive.s[i], 0.1)} m \u00b7 ${fixed(drive.speed[i], 0.1)} m/s`];
    if (drives.length > 1) lines.unshift(drive.name);
    if (gap) {
      lines.push(`gap: ${short(smoothed(drive, "before")[i])} N`);
      if (numbers.named) lines.push(`with the physics: ${short(smoothed(drive, "after")[i])} N`);
    }
    if (!drive.compared[i]) lines.push("not compared");
    const [x, y] = position(drive, i);
    return { x, y, lines };
  }

  /* Mark one moment in every chart that shows moments. */
  function link(found) {
    if (!found) { for (const one of Object.values(charts)) one.mark(null); return; }
    const [drive, i] = found;
    if (charts.track) charts.track.mark(trackX(drive)[i], trackY(drive)[i]);
    if (charts.strip) charts.strip.mark(drive[state.along][i]);
    if (charts.map) charts.map.mark(drive[AXES[state.axes][0]][i], drive[AXES[state.axes][1]][i]);
  }

  function legend(name, ...parts) {
    document.querySelector(`#plot-${name} .legend`).replaceChildren(...parts);
  }

  /* ---- controls ---- */
  function pick(name, title, choices, changed) {
    const set = element("fieldset", {}, element("legend", {}, title));
    const box = element("span", { class: "pick" });
    for (const [value, text] of choices) {
      const input = element("input", { type: "radio", name, value });
      input.checked = String(state[name]) === String(value);
      input.addEventListener("change", () => { state[name] = value; changed(); });
      box.append(element("label", {}, input, element("span", {}, text)));
    }
    set.append(box);
    return set;
  }

  function list(name, title, choices, changed) {
    const select = element("select", { name });
    choices.forEach(([value, text]) => select.append(element("option", { value }, text)));
    select.value = state[name];
    select.addEventListener("change", () => { state[name] = Number(select.value); changed(); });
    return element("label", {}, `${title} `, select);
  }

  const charts = {};
  function redraw(...names) { for (const name of names) if (charts[name]) charts[name].redraw(); }
  function showAll(...names) { for (const name of names) if (charts[name]) charts[name].show(null); }

  function buildControls() {
    const bar = document.getElementById("controls");
    bar.addEventListener("submit", (event) => event.preventDefault());
    const draw = () => redraw("map", "track", "strip");
    if (gap) {
      bar.append(pick("channel", "Force", numbers.forces.map((text, k) => [k, text]), draw));
      const stages = [["before", "gap"], ...(numbers.named ? [["after", "residual"]] : []), ["compared", "compared"]];
      bar.append(pick("stage", "Maps show", stages, draw));
      bar.append(pick("seconds", "Average over", [[0.2, "0.2 s"], [1, "1 s"], [3, "3 s"]], draw));
      bar.append(pick("along", "Over", [["t", "time"], ["s", "distance"]], () => showAll("strip")));
    }
    bar.append(list("axes", "Map", AXES.map(([, , text], k) => [k, text]), () => showAll("map")));
    if (drives.length > 1) {
      bar.append(list("drive", "Drive", [[-1, "all"], ...drives.map((drive, k) => [k, drive.name])], () => showAll("map", "track", "strip")));
    }
  }

  function rms(values) { return Math.sqrt(values.reduce((sum, v) => sum + v * v, 0) / Math.max(values.length, 1)); }

  if (drives.length) {
    // Where single moments are noise, an average over more of them is the better first view.
    const [b, a] = ["before", "after"].map((stage) => rms(drives.flatMap((drive) => [...drive[stage][state.channel]])));
    if (numbers.named ? b < 1.3 * a : gap) state.seconds = 1;
    buildControls();
    for (const { host, options } of [map, track, strip]) {
      const place = document.querySelector(`#plot-${host} .canvas`);
      if (place) charts[host] = new Plot(place, options);
    }
    redraw("map", "track", "strip");
  }
})();
