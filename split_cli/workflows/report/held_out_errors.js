/* Held-out errors of one step and of open-loop simulation, with and without the identified effects. */
(() => {
  const { Plot, shape, element, path, short, between, csv } = Charts;
  const numbers = JSON.parse(document.getElementById("numbers").textContent);
  if (!numbers.help) return;
  const BEFORE = "var(--simulated)";
  const AFTER = "var(--corrected)";

  function key(color, text, dashed = false) {
    const line = shape("line", { x1: 0, x2: 22, y1: 6, y2: 6, stroke: color, "stroke-width": 3, "stroke-dasharray": dashed ? "4 3" : "none" });
    return element("span", { class: "key" }, shape("svg", { width: 22, height: 12, "aria-hidden": "true" }, line), text);
  }

  const ROWS = [
    ["before", "as it is", BEFORE], ["physics", "effects", AFTER], ["split_only", "SPLIT only", "var(--nominal)"], ["after", "both", "var(--learned)"], ["persistence", "persistence", "var(--soft)"],
  ].filter(([stage]) => numbers.named || !["physics", "after"].includes(stage)); // without a name there is nothing to add

  const LINES = ROWS.map(([stage, text, color]) => [stage, { before: "simulation as it is", physics: "with the identified effects", after: "with effects and SPLIT" }[stage] || text, color]);

  function figure(host, title) {
    const canvas = element("div", { class: "canvas" });
    host.append(element("figure", { class: "plot" }, element("figcaption", {}, element("b", {}, title)), canvas));
    return canvas;
  }

  function errorChart(host, help, channel) {
    const { symbol, name, unit: label } = help.channels[channel];
    const bars = ROWS.map(([stage, text, color]) => {
      const { rms: values, interval } = help.errors[stage];
      return { text, color, stage, value: values[channel], interval: interval ? interval[channel] : [values[channel], values[channel]] };
    });
    const floor = help.floor && help.floor[channel];
    const near = bars.filter((bar) => bar.stage !== "persistence").flatMap((bar) => bar.interval).concat(floor ? [floor] : []);
    const [low, high] = [Math.min(...near), Math.max(...near)];
    const plot = new Plot(figure(host, `${name} (${symbol})`), {
      zoom: "x",
      name: `error-${symbol}`,
      keys: () => bars.map(({ color, text }) => ({ color, text })),
      csv: () => csv([["model", `rms error [${label}]`, "low 95 %", "high 95 %"], ...bars.map((bar) => [bar.text, bar.value, ...bar.interval]), ["noise floor", floor, "", ""]]),
      rows: ROWS.map(([, text]) => text),
      height: () => 66 + 26 * ROWS.length,
      x: () => `rms error [${label}]`,
      label: () => `${name} error: ${bars.map((bar) => `${bar.text} ${short(bar.value)}`).join(", ")} ${label}.`,
      domain: (view) => ({ x: view ? view.x : [low - 0.12 * (high - low), high + 0.16 * (high - low)], y: [-0.6, ROWS.length - 0.4] }),
      draw(layer) {
        const at = (v) => plot.sx(v);
        if (floor) layer.append(shape("rect", { x: plot.left, y: plot.top, width: Math.max(at(floor) - plot.left, 0), height: plot.tall, fill: "var(--noise)" }));
        bars.forEach((bar, k) => {
          const y = plot.sy(ROWS.length - 1 - k);
          const beyond = bar.value > plot.x[1];
          if (beyond) {
            const end = plot.left + plot.inner - 4;
            layer.append(shape("text", { x: end, y: y + 4, "text-anchor": "end" }, `${short(bar.value)} \u2192`));
            return;
          }
          layer.append(shape("line", { x1: at(bar.interval[0]), x2: at(bar.interval[1]), y1: y, y2: y, stroke: bar.color, "stroke-width": 2.5 }));
          layer.append(shape("circle", { cx: at(bar.value), cy: y, r: 5, fill: bar.color, stroke: "var(--ground)" }));
        });
      },
      hover(x, y) {
        const bar = bars[ROWS.length - 1 - Math.round(y)];
        if (!bar) return null;
        const lines = [`${bar.text}: ${short(bar.value)} ${label}`, `95 %: ${short(bar.interval[0])} to ${short(bar.interval[1])}`];
        if (floor) lines.push(`noise floor: ${short(floor)}`);
        return { x: between(bar.value, plot.x[0], plot.x[1]), y: Math.round(y), lines };
      },
    });
    plot.redraw();
  }

  function rolloutChart(host, help, channel) {
    const { symbol, name } = help.channels[channel];
    const label = channel === 2 ? "rad/s" : "m/s";
    const value = (one, stage) => one.errors[stage].rms[channel];
    const interval = (one, stage) => (one.errors[stage].interval || [])[channel];
    const ends = help.rollouts.map((one) => one.horizon);
    const near = LINES.filter(([stage]) => stage !== "persistence").flatMap(([stage]) => help.rollouts.map((one) => (interval(one, stage) || [0, value(one, stage)])[1]));
    const top = Math.max(...near);
    const plot = new Plot(figure(host, `${name} (${symbol})`), {
      zoom: "xy",
      name: `rollout-${symbol}`,
      keys: () => LINES.map(([, text, color]) => ({ color, text })),
      csv: () => csv([["model", "horizon [s]", `rms error [${label}]`, "low 95 %", "high 95 %"], ...help.rollouts.flatMap((one) => [
        ...LINES.map(([stage, text]) => [text, one.horizon, value(one, stage), ...(interval(one, stage) || ["", ""])]), ["noise floor", one.horizon, one.floor[channel], "", ""]])]),
      height: (_, paper) => (paper ? 166 : 230),
      x: () => "horizon [s]",
      y: () => `rms error [${label}]`,
      label: () => `${name} rollout error over the horizon: ${LINES.map(([stage, text]) => `${text} ${short(value(help.rollouts[help.rollouts.length - 1], stage))}`).join(", ")} ${label} at the end.`,
      domain: (view) => view || { x: [0, Math.max(...ends) * 1.06], y: [0, top * 1.1] },
      draw(layer) {
        const floor = help.rollouts.map((one) => [plot.sx(one.horizon), plot.sy(one.floor[channel])]);
        const ground = plot.top + plot.tall;
        layer.append(shape("path", { d: `${path([[plot.left, floor[0][1]], ...floor, [plot.left + plot.inner, floor[floor.length - 1][1]], [plot.left + plot.inner, ground], [plot.left, ground]])}Z`, fill: "var(--noise)" }));
        LINES.forEach(([stage, , color], k) => {
          const shift = (k - (LINES.length - 2) / 2) * 3; // so that intervals at one horizon stand side by side
          const points = help.rollouts.map((one) => [plot.sx(one.horizon) + (stage === "persistence" ? 0 : shift), plot.sy(value(one, stage))]);
          layer.append(shape("path", { d: path(points), fill: "none", stroke: color, "stroke-width": 1.8, "stroke-dasharray": stage === "persistence" ? "4 3" : "none" }));
          help.rollouts.forEach((one, i) => {
            const ends = interval(one, stage);
            if (stage !== "persistence" && ends) layer.append(shape("line", { x1: points[i][0], x2: points[i][0], y1: plot.sy(ends[0]), y2: plot.sy(ends[1]), stroke: color, "stroke-width": 1.4 }));
            layer.append(shape("circle", { cx: points[i][0], cy: points[i][1], r: 3.6, fill: color, stroke: "var(--ground)" }));
          });
        });
      },
      hover(x) {
        const one = help.rollouts.reduce((best, other) => (Math.abs(other.horizon - x) < Math.abs(best.horizon - x) ? other : best));
        const errors = LINES.map(([stage, text]) => {
          const ends = interval(one, stage);
          return `${text}: ${short(value(one, stage))} ${label}${ends ? ` (${short(ends[0])} to ${short(ends[1])})` : ""}`;
        });
        return { x: one.horizon, y: between(value(one, "before"), ...plot.y), lines: [`${short(one.horizon)} s ahead`, ...errors, `noise floor: ${short(one.floor[channel])} ${label}`] };
      },
    });
    plot.redraw();
  }

  {
    const errors = document.getElementById("errors");
    const rollouts = document.getElementById("rollouts");
    numbers.help.channels.forEach((_, channel) => errorChart(errors, numbers.help, channel));
    if (rollouts) {
      const names = [...LINES.map(([stage, text, color]) => key(color, text, stage === "persistence")), element("span", {}, "grey: noise floor; bars: 95 % intervals; zoom out for persistence")];
      document.getElementById("rollout-legend").replaceChildren(...names);
      numbers.help.channels.forEach((_, channel) => rolloutChart(rollouts, numbers.help, channel));
    }
  }
})();
