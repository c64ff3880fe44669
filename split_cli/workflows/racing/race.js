/* The track with the cars of chosen laps, played. */
(() => {
  const race = JSON.parse(document.getElementById("numbers").textContent);
  const named = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  const find = (id) => document.getElementById(id);
  const slider = find("time"), clock = find("clock"), play = find("play"), pace = find("pace"), view = find("view"), status = find("status");
  const chosen = new Set([...race.laps.keys()].filter((k) => race.laps[k].shown));
  const colour = (k) => named(race.laps[k].role); // and dashes, as in the charts below
  const dashes = (k) => (race.laps[k].dash ? race.laps[k].dash.split(" ").map(Number) : []);
  let now = 0, running = false, before = 0;

  race.laps.forEach((lap, k) => {
    const label = document.createElement("label"), box = document.createElement("input"), { shape } = Charts;
    const swatch = shape("svg", { width: 22, height: 8, "aria-hidden": "true" }, shape("line", { x1: 0, x2: 22, y1: 4, y2: 4, "stroke-width": 5, "stroke-dasharray": dashes(k).join(" "), stroke: `var(--${lap.role})` }));
    box.type = "checkbox";
    box.checked = chosen.has(k);
    box.dataset.lap = String(k);
    box.addEventListener("change", () => { box.checked ? chosen.add(k) : chosen.delete(k); inCharts(k); setTime(Math.min(now, longest())); });
    const off = lap.outside ? `, ${lap.outside.toFixed(2)} m off the track` : "";
    label.append(box, swatch, `${lap.name}${lap.time === null ? ", not finished" : `, ${lap.time.toFixed(2)} s`}${off}`);
    find("choice").append(label);
  });

  // A lap that is chosen here is drawn in the charts, too; each chart's own legend may differ afterwards.
  function inCharts(k) {
    for (const key of document.querySelectorAll(".legend .switch")) {
      if (key.textContent.trim() === race.laps[k].name && (key.getAttribute("aria-pressed") === "true") !== chosen.has(k)) key.click();
    }
  }

  const laps = () => [...chosen].sort((a, b) => a - b);
  const last = (k) => race.laps[k].t[race.laps[k].t.length - 1];
  const longest = () => Math.max(0.05, ...laps().map(last));

  // Where a lap is at a time: between samples in a straight line.
  function at(lap, time) {
    const t = lap.t;
    let low = 0, high = t.length - 1;
    if (time >= t[high]) return high;
    while (high - low > 1) { const middle = (low + high) >> 1; if (t[middle] <= time) low = middle; else high = middle; }
    return low + (time - t[low]) / (t[high] - t[low]);
  }
  const value = (list, place) => {
    const low = Math.floor(place), high = Math.min(low + 1, list.length - 1);
    return list[low] + (place - low) * (list[high] - list[low]);
  };

  function frame(canvas, xs, ys, equal, pad) {
    let [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    let sx = (canvas.width - 2 * pad) / (x1 - x0 || 1), sy = (canvas.height - 2 * pad) / (y1 - y0 || 1);
    if (equal) sx = sy = Math.min(sx, sy);
    const left = (canvas.width - sx * (x1 - x0)) / 2, top = (canvas.height - sy * (y1 - y0)) / 2;
    return (x, y) => [left + (x - x0) * sx, canvas.height - top - (y - y0) * sy];
  }
  function line(pen, points, style, width, close, dash = []) {
    pen.beginPath();
    pen.setLineDash(dash);
    points.forEach(([x, y], k) => (k ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    if (close) pen.closePath();
    pen.strokeStyle = style;
    pen.lineWidth = width;
    pen.stroke();
  }

  const track = find("track"), ground = race.left.concat(race.right);
  const growth = () => Math.max(1, track.width / (track.clientWidth || track.width)); // in a narrow window
  const whole = () => frame(track, ground.map((p) => p[0]), ground.map((p) => p[1]), true, 14 + 20 * growth());
  const road = Math.hypot(race.left[0][0] - race.right[0][0], race.left[0][1] - race.right[0][1]);

  /* The whole track, or six of its widths about the first chosen car. */
  function frameNow() {
    const [k] = laps();
    if (view.value === "whole" || k === undefined) return whole();
    const lap = race.laps[k], place = at(lap, now), size = track.height / (6 * road);
    const [x0, y0] = [value(lap.x, place), value(lap.y, place)];
    return (x, y) => [track.width / 2 + (x - x0) * size, track.height / 2 - (y - y0) * size];
  }
  /* The line of start and finish, and distances along the centre line. */
  function marks(pen, onTrack, grown) {
    const step = [20, 50, 100, 200, 500, 1000].find((one) => race.length / one < 12) || 2000;
    pen.font = `${12 * grown}px sans-serif`;
    pen.fillStyle = named("soft");
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    const placed = [];
    for (let s = 0; s < race.length - 0.4 * step; s += step) {
      const i = Math.round((s / race.length) * race.left.length) % race.left.length;
      const [[x0, y0], [x1, y1]] = [onTrack(...race.left[i]), onTrack(...race.right[i])], far = (15 * grown) / Math.hypot(x1 - x0, y1 - y0);
      line(pen, [[x0, y0], [x1, y1]], named(s ? "soft" : "ink"), (s ? 0.7 : 3) * grown, false);
      const [x, y] = [x1 + far * (x1 - x0), y1 + far * (y1 - y0)];
      // Where the track comes near itself, or is small, a number gives way to one that stands already.
      if (placed.some(([a, b]) => Math.abs(a - x) < 28 * grown && Math.abs(b - y) < 14 * grown)) continue;
      placed.push([x, y]);
      pen.fillText(s ? `${s}` : "0 m", x, y);
    }
  }
  function drawTrack() {
    const onTrack = frameNow();
    const pen = track.getContext("2d"), grown = growth();
    pen.clearRect(0, 0, track.width, track.height);
    for (const border of [race.left, race.right]) line(pen, border.map(([x, y]) => onTrack(x, y)), named("soft"), 1.5 * grown, true);
    marks(pen, onTrack, grown);
    for (const k of laps()) {
      const lap = race.laps[k];
      line(pen, lap.x.map((x, i) => onTrack(x, lap.y[i])), colour(k), 1.4 * grown, false, dashes(k));
    }
    for (const k of laps()) {
      const lap = race.laps[k], place = at(lap, now), [x, y] = onTrack(value(lap.x, place), value(lap.y, place));
      pen.save();
      pen.translate(x, y);
      pen.rotate(-value(lap.yaw, place));
      pen.scale(grown, grown);
      pen.fillStyle = colour(k);
      pen.fillRect(-9, -4.5, 18, 9);
      pen.fillStyle = named("ground");
      pen.fillRect(4, -3, 3, 6);
      pen.restore();
    }
  }

  function tell() {
    const shown = laps();
    status.textContent = shown.length
      ? shown.map((k) => { const lap = race.laps[k], p = at(lap, now); return `${lap.name}: ${value(lap.s, p).toFixed(0)}\u00a0m, ${value(lap.v, p).toFixed(1)}\u00a0m/s`; }).join("; ")
      : "No lap is chosen.";
  }
  function setTime(time) {
    now = Math.max(0, time);
    slider.max = String(longest());
    slider.value = String(now);
    clock.textContent = `${now.toFixed(1)} s`;
    drawTrack(); tell();
    const [k] = laps();
    if (Charts.markStrips) Charts.markStrips(k === undefined ? null : now, k === undefined ? null : value(race.laps[k].s, at(race.laps[k], now)));
  }
  function tick(stamp) {
    if (!running) return;
    const passed = Math.min(0.2, (stamp - before) / 1000);
    before = stamp;
    if (now >= longest()) { stop(); return; }
    setTime(Math.min(longest(), now + passed * Number(pace.value)));
    requestAnimationFrame(tick);
  }
  function stop() { running = false; play.textContent = "Play"; }
  play.addEventListener("click", () => {
    if (running) { stop(); return; }
    if (now >= longest()) setTime(0);
    running = true;
    play.textContent = "Pause";
    before = performance.now();
    requestAnimationFrame(tick);
  });
  slider.addEventListener("input", () => { stop(); setTime(Number(slider.value)); });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawTrack);
  addEventListener("resize", drawTrack);
  view.addEventListener("change", drawTrack);
  setTime(0);
})();
