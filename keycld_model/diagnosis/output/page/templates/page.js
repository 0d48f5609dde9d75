"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  const floats = (text) => {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    return Array.from(new Float32Array(bytes.buffer), (x) => (Number.isNaN(x) ? null : x));
  };
  const config = { displaylogo: false, responsive: true, displayModeBar: "hover", modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"] };
  const still = { displayModeBar: false, responsive: true };
  const plain = (text) => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;"); /* Plotly reads its texts as HTML. */
  const narrow = () => window.innerWidth < 560;

  /* What all plots share. */
  const frame = (height) => ({
    height, margin: { l: narrow() ? 44 : 58, r: 8, t: 30, b: 38 }, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    font: { family: getComputedStyle(document.body).fontFamily, size: 13, color: colour("ink") }, hovermode: "x", showlegend: true,
    legend: { orientation: "h", x: 0, y: 1, yanchor: "bottom", xanchor: "left" },
    hoverlabel: { bgcolor: colour("card"), bordercolor: colour("faint"), font: { color: colour("ink") } },
    modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("faint"), activecolor: colour("soft") }, shapes: [], annotations: [],
  });
  const axis = (more) => ({ gridcolor: colour("grid"), zerolinecolor: colour("faint"), linecolor: colour("faint"), automargin: true, ...more });
  const key = (base, i) => (i ? base + (i + 1) : base);

  /* Intervals in which a finding acts, over all rows of a plot or those of its joint. */
  const shade = (layout, id, rows) => {
    for (const finding of data.when) {
      for (const [from, to] of finding.intervals[id] || finding.intervals["*"] || []) {
        rows.forEach((joint, row) => {
          if (finding.joint && finding.joint !== joint) return;
          layout.shapes.push({ type: "rect", xref: "x", yref: key("y", row) + " domain", x0: from, x1: to, y0: 0, y1: 1, fillcolor: colour("found"), opacity: 0.13, line: { width: 0 }, layer: "below" });
        });
        layout.annotations.push({ x: (from + to) / 2, y: 1, xref: "x", yref: key("y", Math.max(0, rows.indexOf(finding.joint))) + " domain", yanchor: "bottom", text: String(finding.number), showarrow: false, font: { color: colour("found"), size: 12 } });
      }
    }
  };

  /* Rows of a plot with one time axis below; heights in pixels. */
  const rows = (heights, titles) => {
    const gap = 26, total = heights.reduce((a, b) => a + b, 0) + gap * (heights.length - 1);
    const layout = frame(total + 100);
    layout.margin.t = 54;
    let top = 1;
    heights.forEach((height, i) => {
      layout[key("yaxis", i)] = axis({ domain: [Math.max(0, top - height / total), top], title: { text: titles[i], standoff: 6 } });
      top -= (height + gap) / total;
    });
    layout.legend.y = 1 + 8 / total;
    layout.xaxis = axis({ title: { text: "time (s)", standoff: 8 }, anchor: key("y", heights.length - 1), domain: [0, 1] });
    return layout;
  };

  const line = (name, x, y, row, css, width, first, more) => ({
    type: "scatter", mode: "lines", name, x, y, yaxis: key("y", row), line: { color: colour(css), width }, legendgroup: name, showlegend: first,
    hovertemplate: "%{y:.4g}<extra>" + name + "</extra>", connectgaps: false, ...more,
  });

  const ends = (time) => {
    const known = time.filter((t) => t !== null), pad = 0.008 * (known[known.length - 1] - known[0]);
    return [known[0] - pad, known[known.length - 1] + pad];
  };

  const drawRollouts = (box, i) => {
    const rollout = data.rollouts[i], time = floats(rollout.time), traces = [], heights = [], titles = [], names = [];
    data.channels.forEach((joint, j) => {
      const measured = floats(rollout.measured[j]), first = j === 0, row = 2 * j;
      const fits = [["refitted", floats(rollout.refitted[j])]];
      if (data.differs) fits.push(["corrected", floats(rollout.corrected[j])]);
      for (const [name, y] of fits) traces.push(line(name, time, y, row, name, 1.8, first));
      for (const [name, y] of fits) {
        const error = measured.map((m, k) => (m === null || y[k] === null ? null : 1000 * (m - y[k])));
        traces.push(line(name, time, error, row + 1, name, 1.4, false));
      }
      traces.push({
        type: "scatter", mode: "markers", name: "measured", x: time, y: measured, yaxis: key("y", row), legendgroup: "measured", legendrank: 1, showlegend: first,
        marker: { color: colour("ink"), size: 3.5, opacity: 0.6 }, hovertemplate: "%{y:.4g}<extra>measured</extra>",
      });
      const small = joint.unit === "rad" ? "mrad" : "mm";
      heights.push(170, 100);
      titles.push(`${plain(joint.name)} (${joint.unit})`, `error (${small})`);
      names.push(joint.name, joint.name);
    });
    const layout = rows(heights, titles);
    layout.xaxis.range = ends(time);
    shade(layout, rollout.id, names);
    Plotly.react(box, traces, layout, narrow() ? still : config);
  };

  const drawResiduals = (box, i) => {
    const piece = data.residuals[i], time = floats(piece.time), traces = [], layout = rows(data.channels.map(() => 170), data.channels.map((j) => plain(j.name)));
    data.channels.forEach((joint, j) => {
      const before = floats(piece.before[j]), after = floats(piece.after[j]);
      if (data.differs) traces.push(line("before", time, before, j, "refitted", 1.3, j === 0));
      traces.push(line(data.differs ? "after" : "refitted", time, after, j, data.differs ? "corrected" : "refitted", 1.3, j === 0));
      const sizes = (data.differs ? before : after).filter((z) => z !== null).map(Math.abs).sort((a, b) => a - b);
      const reach = Math.max(4.5, 1.1 * (sizes[Math.floor(0.998 * (sizes.length - 1))] || 0));
      layout[key("yaxis", j)].range = [-reach, reach];
      layout.shapes.push({ type: "rect", xref: "paper", yref: key("y", j), x0: 0, x1: 1, y0: -2, y1: 2, fillcolor: colour("corrected"), opacity: 0.1, line: { width: 0 }, layer: "below" });
    });
    layout.xaxis.range = ends(time);
    shade(layout, piece.id, data.channels.map((j) => j.name));
    Plotly.react(box, traces, layout, narrow() ? still : config);
  };

  const drawWhiteness = (box) => {
    const which = data.differs ? [["before", "before", "refitted"], ["after", "after", "corrected"]] : [["after", "refitted", "refitted"]];
    data.channels.forEach((joint, j) => {
      const white = data.whiteness[j];
      const cells = [0, 1].map((k) => box.children[2 * j + k] || box.appendChild(document.createElement("div")));
      const said = which.map(([key, name]) => `${data.differs ? name + " " : ""}${(100 * white[key].within).toFixed(0)} %`).join(", ");
      cells[0].setAttribute("role", "img");
      cells[0].setAttribute("aria-label", `Histogram of the residuals of ${joint.name}; within two standard deviations: ${said}`);
      cells[1].setAttribute("role", "img");
      cells[1].setAttribute("aria-label", `Autocorrelation of the residuals of ${joint.name}`);
      const base = (title) => {
        const layout = frame(230);
        layout.title = { text: title, font: { size: 13.5 }, x: 0, xanchor: "left", y: 0.98, yanchor: "top" };
        layout.margin = { l: 40, r: 6, t: 34, b: 36 };
        layout.showlegend = false;
        return layout;
      };
      const bars = which.map(([key, name, css]) => ({
        type: "scatter", mode: "lines", name, x: data.bins, y: white[key].density, line: { shape: "hvh", width: 1.6, color: colour(css) },
        fill: "tozeroy", fillcolor: colour(css) + "26", hovertemplate: "%{y:.3f}<extra>" + name + "</extra>",
      }));
      bars.push({ type: "scatter", mode: "lines", name: "noise", x: data.bins, y: data.bins.map((x) => Math.exp(-x * x / 2) / Math.sqrt(2 * Math.PI)), line: { color: colour("ink"), width: 1, dash: "dot" }, hoverinfo: "skip" });
      const left = base(`${plain(joint.name)}, within ±2: ${said}`);
      left.xaxis = axis({ title: { text: "residual", standoff: 4 }, range: [-5, 5] });
      left.yaxis = axis({ rangemode: "tozero", showticklabels: false });
      Plotly.react(cells[0], bars, left, still);
      const lags = white.after.correlation.map((_, k) => k), limit = 1.96 / Math.sqrt(Math.max(1, white.number));
      const right = base(`${plain(joint.name)}, autocorrelation`);
      right.xaxis = axis({ title: { text: "lag (samples)", standoff: 4 }, range: [0.3, lags.length - 0.5] });
      const values = which.flatMap(([key]) => white[key].correlation.slice(1));
      right.yaxis = axis({ range: [Math.min(-0.25, ...values) * 1.1, Math.max(0.25, ...values) * 1.1] });
      right.shapes = [{ type: "rect", xref: "paper", yref: "y", x0: 0, x1: 1, y0: -limit, y1: limit, fillcolor: colour("corrected"), opacity: 0.14, line: { width: 0 }, layer: "below" }];
      const stems = which.map(([key, name, css]) => ({
        type: "scatter", mode: "lines+markers", name, x: lags.slice(1), y: white[key].correlation.slice(1), line: { color: colour(css), width: 1.2 },
        marker: { size: 5, color: colour(css) }, hovertemplate: "%{y:.2f}<extra>" + name + "</extra>",
      }));
      Plotly.react(cells[1], stems, right, still);
    });
  };

  /* A section with a list of recordings. */
  const chooser = (section, pieces, draw) => {
    const select = section.querySelector("select"), box = section.querySelector(".plot"), count = section.querySelector(".count");
    pieces.forEach((piece, i) => select.add(new Option(piece.id, i)));
    const show = () => { count.textContent = `${select.selectedIndex + 1} of ${pieces.length}`; draw(box, select.selectedIndex); };
    select.addEventListener("change", show);
    section.querySelectorAll(".step").forEach((button) => button.addEventListener("click", () => {
      select.selectedIndex = (select.selectedIndex + Number(button.dataset.by) + pieces.length) % pieces.length;
      show();
    }));
    section.querySelector(".pick").hidden = !pieces.length;
    return { show: () => pieces.length && show(), select };
  };

  /* The mechanism in motion. */
  const player = (box) => {
    const svg = box.querySelector("svg"), slider = box.querySelector("input"), button = box.querySelector(".play"), clock = box.querySelector("output");
    const shape = data.mechanism, kinds = data.differs ? ["refitted", "corrected", "ink"] : ["refitted", "ink"];
    let clip = null, timer = null, started = 0;
    const show = (frame) => {
      const parts = [];
      kinds.forEach((css) => {
        const path = clip.paths[{ ink: 0, refitted: 1, corrected: 2 }[css]], at = (node) => {
          const k = 2 * (frame * shape.nodes + node);
          return path[k] === null ? null : [path[k], -path[k + 1]];
        };
        const solid = css === "ink", width = clip.size * (solid ? 0.012 : 0.03);
        for (const [a, b] of shape.links) {
          const p = at(a), q = at(b);
          if (p && q) parts.push(`<line x1="${p[0]}" y1="${p[1]}" x2="${q[0]}" y2="${q[1]}" stroke="var(--${css})" stroke-opacity="${solid ? 1 : 0.6}" stroke-width="${width}" stroke-linecap="round"/>`);
        }
        if (solid) for (let node = 0; node < shape.nodes; node++) {
          const p = at(node), slide = shape.slides.includes(node);
          if (p && slide) parts.push(`<rect x="${p[0] - clip.size * 0.06}" y="${p[1] - clip.size * 0.03}" width="${clip.size * 0.12}" height="${clip.size * 0.06}" rx="${clip.size * 0.012}" fill="var(--link)" stroke="var(--ink)" stroke-width="${clip.size * 0.006}"/>`);
          else if (p) parts.push(`<circle cx="${p[0]}" cy="${p[1]}" r="${clip.size * 0.015}" fill="var(--paper)" stroke="var(--ink)" stroke-width="${clip.size * 0.008}"/>`);
        }
      });
      svg.innerHTML = parts.join("");
      slider.value = frame;
      clock.textContent = `${clip.time[frame].toFixed(2)} s`;
    };
    const stop = () => { cancelAnimationFrame(timer); timer = null; button.textContent = "▶"; button.setAttribute("aria-label", "Play"); };
    const tick = (now) => {
      const t = clip.time[0] + (now - started) / 1000, frame = clip.time.findIndex((x) => x >= t);
      if (frame < 0) { show(clip.time.length - 1); stop(); return; }
      show(frame);
      timer = requestAnimationFrame(tick);
    };
    button.addEventListener("click", () => {
      if (timer) return stop();
      const from = Number(slider.value) >= clip.time.length - 1 ? 0 : Number(slider.value);
      started = performance.now() - 1000 * (clip.time[from] - clip.time[0]);
      button.textContent = "❚❚";
      button.setAttribute("aria-label", "Pause");
      timer = requestAnimationFrame(tick);
    });
    slider.addEventListener("input", () => { stop(); show(Number(slider.value)); });
    return (i) => {
      stop();
      const packed = shape.clips[i];
      box.hidden = !packed;
      if (!packed) return;
      clip = { time: floats(packed.time), paths: packed.paths.map(floats) };
      const xs = [], ys = [];
      clip.paths[0].forEach((x, k) => x !== null && (k % 2 ? ys : xs).push(k % 2 ? -x : x));
      const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
      clip.size = Math.max(x1 - x0, y1 - y0, 1e-6);
      const pad = 0.08 * clip.size;
      svg.setAttribute("viewBox", `${x0 - pad} ${y0 - pad} ${x1 - x0 + 2 * pad} ${y1 - y0 + 2 * pad}`);
      slider.max = clip.time.length - 1;
      show(0);
    };
  };

  const plots = () => {
    const play = player(document.querySelector(".player"));
    const rollouts = chooser(document.getElementById("rollouts"), data.rollouts, drawRollouts);
    const residuals = chooser(document.getElementById("residuals"), data.residuals, drawResiduals);
    const moved = () => play(rollouts.select.selectedIndex);
    rollouts.select.addEventListener("change", moved);
    document.querySelectorAll("#rollouts .step").forEach((button) => button.addEventListener("click", moved));
    const all = () => { rollouts.show(); residuals.show(); drawWhiteness(document.querySelector(".white")); };
    all();
    moved();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", all);
    matchMedia("(max-width: 560px)").addEventListener("change", all);
  };
  if (document.getElementById("rollouts")) plots(); /* Nothing was simulated where images cannot be read. */
  document.querySelectorAll(".code button").forEach((button) => button.addEventListener("click", () => {
    navigator.clipboard.writeText(button.nextElementSibling.textContent).then(() => { button.textContent = "Copied"; });
  }));
})();
