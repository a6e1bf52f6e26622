"use strict";
// Draws the robot of #replay-data on #replay-canvas: parallel projection, z up, the floor at 0 or the pieces of an uneven
// ground. The robot moves along x, or on a circle around the origin.
(() => {
  const at = (name) => document.getElementById("replay-" + name);
  const data = JSON.parse(at("data").textContent);
  const canvas = at("canvas"), slider = at("slider"), play = at("play"), moment = at("moment");
  const choice = at("deployment"), speed = at("speed"), zoom = at("zoom"), follow = at("follow");
  const radius = data.circle, MARKS = 12, TRAIL = 120, TICKS = 144;
  const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#7a5195", "#999999"];
  const SHADES = {body: "#555", near: "#004a75", far: "#0072b2"};
  let motion = null, frame = 0, reach = 0.45, playing = false, before = 0, azimuth = -1.15, elevation = 0.22, drag = null;

  async function unpacked(source) {
    const bytes = Uint8Array.from(atob(source.packed), (letter) => letter.charCodeAt(0));
    const inflated = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    const whole = new DataView(await new Response(inflated).arrayBuffer());
    const found = {frames: source.frames, rate: source.rate, deployment: source.deployment};
    let row = 0;
    const channels = source.ranges.map(([low, high, levels]) => {
      const values = new Float64Array(source.frames).fill(low);
      if (high === low) return values;
      let level = 0, change = 0;  // the levels are the sums of the sums of what is stored
      for (let i = 0; i < source.frames; i++) {
        change = change + whole.getUint16(2 * (row * source.frames + i), true) & 65535;
        level = level + change & 65535;
        values[i] = low + (high - low) * level / levels;
      }
      row++;
      return values;
    });
    found.step = channels[0].map(Math.round);
    found.body = channels.slice(1, 4);
    found.parts = data.points.map((_, point) => channels.slice(4 + 3 * point, 7 + 3 * point));
    const contacts = 4 + 3 * data.points.length, signals = contacts + data.feet.length;
    found.contacts = channels.slice(contacts, signals);
    found.signals = channels.slice(signals);
    found.steps = new Map(source.steps.map(([step, target, reached, command, ground]) => [step, {target, reached, command, ground}]));
    found.ground = source.ground;
    found.ends = new Map();
    for (let i = 1; i < source.frames; i++) if (found.step[i] !== found.step[i - 1]) found.ends.set(found.step[i - 1], i - 1);
    if (found.steps.has(found.step[source.frames - 1])) found.ends.set(found.step[source.frames - 1], source.frames - 1);
    return found;
  }

  const vectorAt = (axes, i) => axes.map((values) => values[i]);
  const bodyAt = (i) => vectorAt(motion.body, i);
  const moved = (point, by) => point.map((value, axis) => value + by[axis]);
  // How far the body has come: an angle on the circle, or a length along x.
  const progress = (i) => (radius ? Math.atan2(motion.body[0][i], -motion.body[1][i]) : motion.body[0][i]);
  // Point above the track.
  const above = (s, up) => (radius ? [radius * Math.sin(s), -radius * Math.cos(s), up] : [s, 0, up]);

  function draw() {
    if (!motion) return;  // it is still being unpacked
    const wide = canvas.clientWidth, high = canvas.clientHeight, dots = window.devicePixelRatio || 1;
    if (canvas.width !== Math.round(wide * dots) || canvas.height !== Math.round(high * dots)) {
      canvas.width = Math.round(wide * dots);
      canvas.height = Math.round(high * dots);
    }
    const pen = canvas.getContext("2d"), s = progress(frame), metres = radius || 1;  // metres unit of progress
    const turn = azimuth + (follow.checked && radius ? s : 0);
    const [a, b, c, d] = [Math.cos(turn), Math.sin(turn), Math.cos(elevation), Math.sin(elevation)];
    const far = radius ? 2.4 : 1.2 * reach, close = 0.32 / 0.45 * reach;
    const size = far * Math.pow(close / far, zoom.value / 100), scale = Math.min(wide, 1.6 * high) / (3.2 * size);
    const middle = follow.checked ? above(s, 0.73 * reach) : radius ? [0, 0, 0.3] : above(motion.middle, 0.73 * reach);
    const near = radius ? Math.min(1, zoom.value / 60) : 1;
    const centre = [near * middle[0], near * middle[1], middle[2]];
    const project = ([x, y, z]) => {
      const [u, v, w] = [x - centre[0], y - centre[1], z - centre[2]];
      return [wide / 2 + scale * (b * u - a * v) * -1, high / 2 - scale * (c * w - d * (a * u + b * v))];
    };
    pen.setTransform(dots, 0, 0, dots, 0, 0);
    pen.fillStyle = "#fff";
    pen.fillRect(0, 0, wide, high);
    pen.lineCap = pen.lineJoin = "round";

    function line(points, colour, width, dashes = []) {
      pen.beginPath();
      points.map(project).forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
      pen.strokeStyle = colour;
      pen.lineWidth = width;
      pen.setLineDash(dashes);
      pen.stroke();
    }
    function dot(point, colour, r, full) {
      const [x, y] = project(point);
      pen.beginPath();
      pen.arc(x, y, r, 0, 2 * Math.PI);
      pen.setLineDash([]);
      pen.lineWidth = 1.5;
      pen.fillStyle = full ? colour : "#fff";
      pen.strokeStyle = colour;
      pen.fill();
      pen.stroke();
    }

    if (motion.ground.length) drawGround(line, s);
    else if (radius) {
      for (const ring of [0.88, 1, 1.12]) {
        const circle = [];
        for (let i = 0; i <= TICKS; i++) circle.push(above(2 * Math.PI * i / TICKS, 0).map((value) => ring * value));
        line(circle, ring === 1 ? "#888" : "#ccc", 1);
      }
      for (let i = 0; i < TICKS; i++) {
        const [x, y] = above(2 * Math.PI * i / TICKS, 0);
        line([[0.88 * x, 0.88 * y, 0], [1.12 * x, 1.12 * y, 0]], i % 12 ? "#ddd" : "#999", 1);
      }
    } else {
      const pitch = 0.1, first = Math.floor((s - 4 * reach) / pitch), last = Math.ceil((s + 4 * reach) / pitch);
      for (const side of [-1, 0, 1])
        line([[first * pitch, side * reach / 2, 0], [last * pitch, side * reach / 2, 0]], side ? "#ccc" : "#888", 1);
      for (let i = first; i <= last; i++)
        line([[i * pitch, -reach / 2, 0], [i * pitch, reach / 2, 0]], i % 10 ? "#ddd" : "#999", 1);
    }

    const step = motion.step[frame], entry = motion.steps.get(step);
    const heightOf = (state) => (data.height === null ? null : state[data.height]);
    const raised = ({ground}, state) => ground + heightOf(state);
    if (entry && heightOf(entry.target) !== null) {
      const arc = [];
      for (let i = -20; i <= 20; i++) arc.push(above(s + i * 0.03 / metres, raised(entry, entry.target)));
      line(arc, "#000", 1, [6, 5]);
    }
    for (let number = step - MARKS; number < step + (frame === motion.ends.get(step) ? 1 : 0); number++) {
      const end = motion.ends.get(number), known = motion.steps.get(number);
      if (end === undefined || !known || heightOf(known.target) === null) continue;
      const there = progress(end);
      line([-1, 1].map((side) => above(there + side * 0.0375 / metres, raised(known, known.target))), "#000", 2);
      if (heightOf(known.reached) !== null) dot(above(there, raised(known, known.reached)), "#d55e00", 3.5, false);
    }
    const trail = [];
    for (let i = Math.max(0, frame - TRAIL); i <= frame; i++) trail.push(bodyAt(i));
    line(trail, "#e69f00", 1.2);

    const here = motion.parts.map((axes) => moved(vectorAt(axes, frame), bodyAt(frame)));
    const depth = (link) => a * (here[link[0]][0] + here[link[1]][0]) + b * (here[link[0]][1] + here[link[1]][1]);
    for (const link of [...data.links].sort((one, other) => depth(other) - depth(one)))
      line([here[link[0]], here[link[1]]], SHADES[link[3]], Math.max(2, 2 * link[2] * scale));
    const touching = new Set(data.feet.filter((_, foot) => motion.contacts[foot][frame] > 0.5));
    data.points.forEach((ball, point) => {
      const foot = data.feet.includes(point), fill = point === data.body || touching.has(point);
      if (ball) dot(here[point], foot ? "#c00000" : point === data.body ? "#333" : "#004a75", Math.max(2, 0.8 * ball * scale), fill);
    });

    slider.value = frame;
    const time = (frame / motion.rate).toFixed(2), end = ((motion.frames - 1) / motion.rate).toFixed(2);
    moment.textContent = `deployment ${motion.deployment}, ${time} s of ${end} s: ` + (entry
      ? `step ${step} of ${motion.last}. Target ${named(entry.target, data.state)}; ` +
        `reached ${entry.reached.includes(null) ? "no end of the step" : named(entry.reached, data.state)}; ` +
        `command ${named(entry.command, data.command)}.`
      : "before the first step.");
    charts.forEach(drawChart);
  }

  // The pieces of the ground near a progress s, with their risers, as a strip along the track.
  function drawGround(line, s) {
    const metres = radius || 1, turn = 2 * Math.PI * radius, half = radius ? 0.12 * radius : reach / 2, GRID = 0.1;
    const edge = (place, up) => [-1, 1].map((side) => {
      const [x, y, z] = above(place / metres, up);
      return radius ? [x * (1 + side * half / radius), y * (1 + side * half / radius), z] : [x, side * half, z];
    });
    const nearest = (place) => (radius ? place - turn * Math.round((place - s * radius) / turn) : place);
    let before = motion.ground[motion.ground.length - 1];
    for (const piece of motion.ground) {
      const [start, end, low, high, changed] = piece, from = nearest(start), long = end - start;
      const colour = changed ? "#e69f00" : "#999", count = Math.max(1, Math.ceil(long / GRID));
      const places = Array.from({length: count + 1}, (_, i) => [from + long * i / count, low + (high - low) * i / count]);
      const rows = places.map(([place, up]) => edge(place, up));
      for (const side of [0, 1]) line(rows.map((row) => row[side]), colour, changed ? 2.5 : 1.5);
      if (count > 1 || changed) for (const row of rows.slice(1, -1)) line(row, changed ? "#f3d99b" : "#ddd", 1);
      const gap = start - before[1], joined = Math.abs(gap - (turn && turn * Math.round(gap / turn))) < 1e-3;
      const edges = joined ? [edge(from, before[3]), rows[0]] : [rows[0]];
      if (!joined || Math.abs(low - before[3]) > 2e-3) {
        for (const row of edges) line(row, "#999", 1);
        for (const side of [0, 1]) line(edges.map((row) => row[side]), "#999", 1.5);
      }
      before = piece;
    }
  }

  // Curves of the signals with the same unit, over the step that is shown.
  function makeChart(unit) {
    const rows = data.signals.flatMap(([, other], row) => (other === unit ? [row] : []));
    const chart = {unit, rows, canvas: document.createElement("canvas"), legend: document.createElement("p")};
    chart.legend.className = "signal-legend";
    at("signals").append(chart.legend, chart.canvas);
    return chart;
  }

  function drawChart({unit, rows, canvas, legend}) {
    const wide = canvas.clientWidth, high = canvas.clientHeight, dots = window.devicePixelRatio || 1;
    canvas.width = Math.round(wide * dots);
    canvas.height = Math.round(high * dots);
    const pen = canvas.getContext("2d"), left = 56, right = wide - 8, top = 6, bottom = high - 22;
    const step = motion.step[frame], first = motion.step.indexOf(step), last = motion.step.lastIndexOf(step);
    const lows = rows.map((row) => motion.limits[row][0]), highs = rows.map((row) => motion.limits[row][1]);
    const low = Math.min(...lows), range = Math.max(...highs) - low || 1;
    const x = (i) => left + (right - left) * (i - first) / Math.max(1, last - first);
    const y = (value) => bottom - (bottom - top) * (value - low) / range;
    pen.setTransform(dots, 0, 0, dots, 0, 0);
    pen.fillStyle = "#fff";
    pen.fillRect(0, 0, wide, high);
    pen.font = "12px system-ui, sans-serif";
    const stroke = (colour, width, points) => {
      pen.beginPath();
      points.forEach(([across, up], i) => (i ? pen.lineTo(across, up) : pen.moveTo(across, up)));
      pen.strokeStyle = colour;
      pen.lineWidth = width;
      pen.stroke();
    };
    pen.fillStyle = "#444";
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    const decimals = Math.max(0, Math.ceil(-Math.log10(range / 4)));
    for (const value of roundValues(low, low + range, 4)) {
      stroke("#ddd", 1, [[left, y(value)], [right, y(value)]]);
      pen.fillText(written(value, decimals), left - 6, y(value));
    }
    pen.textAlign = "center";
    pen.textBaseline = "top";
    const seconds = (last - first) / motion.rate;
    for (const time of roundValues(0, seconds, Math.max(2, wide / 110))) {
      stroke("#ddd", 1, [[x(first + time * motion.rate), top], [x(first + time * motion.rate), bottom]]);
      pen.fillText(`${Number(time.toFixed(3))} s`, Math.min(x(first + time * motion.rate), right - 14), bottom + 5);
    }
    rows.forEach((row, i) => {
      const points = [];
      for (let k = first; k <= last; k++) points.push([x(k), y(motion.signals[row][k])]);
      stroke(COLOURS[i % COLOURS.length], 1.6, points);
    });
    stroke("#000", 1, [[x(frame), top], [x(frame), bottom]]);
    legend.replaceChildren(...rows.map((row, i) => {
      const entry = document.createElement("span"), mark = document.createElement("i");
      mark.style.borderColor = COLOURS[i % COLOURS.length];
      entry.append(mark, `${data.signals[row][0]} ${written(motion.signals[row][frame], decimals + 1)} ${unit}`);
      return entry;
    }));
  }

  // About `count` round numbers in an interval.
  function roundValues(from, to, count) {
    const raw = (to - from) / count || 1, power = Math.pow(10, Math.floor(Math.log10(raw)));
    const by = power * [1, 2, 5, 10].find((each) => each * power >= raw), values = [];
    for (let k = Math.ceil(from / by); k * by <= to + 1e-9 * by; k++) values.push(k * by);
    return values;
  }

  // A number with a minus sign; zero has none.
  function written(value, decimals) {
    const digits = value.toFixed(decimals);
    return Number(digits) === 0 ? (0).toFixed(decimals) : digits.replace("-", "\u2212");
  }

  function named(values, quantities) {
    return values.map((value, i) => {
      const [name, unit, decimals] = quantities[i];
      return `${name} ` + (value === null ? "unknown" : `${written(value, decimals)} ${unit}`.trim());
    }).join(", ");
  }

  async function choose() {
    const wanted = choice.selectedIndex;
    const found = await unpacked(data.motions[wanted]).catch((error) => {
      moment.textContent = `This browser cannot unpack the replay (${error.message}); one of 2023 or later can.`;
    });
    if (!found || choice.selectedIndex !== wanted) return;
    motion = found;
    motion.limits = motion.signals.map((values) => [Math.min(...values), Math.max(...values)]);
    motion.last = Math.max(...motion.steps.keys());
    motion.middle = (motion.body[0][0] + motion.body[0][motion.frames - 1]) / 2;
    slider.max = motion.frames - 1;
    frame = Math.min(frame, motion.frames - 1);
    draw();
  }

  function run(wanted) {
    if (!motion) return;
    playing = wanted;
    play.textContent = playing ? "Pause" : "Play";
    if (!playing) return;
    if (frame >= motion.frames - 1) frame = 0;
    before = performance.now();
    let exact = frame;
    requestAnimationFrame(function next(now) {
      if (!playing) return;
      if (Math.round(exact) !== frame) exact = frame;
      exact = Math.min(exact + Math.max(0, now - before) / 1000 * motion.rate * Number(speed.value), motion.frames - 1);
      before = now;
      frame = Math.round(exact);
      draw();
      if (frame < motion.frames - 1) requestAnimationFrame(next);
      else run(false);
    });
  }

  function go(to) {
    if (!motion) return;
    frame = Math.max(0, Math.min(motion.frames - 1, to));
    draw();
  }

  // Size of the robot, by which the view is scaled.
  reach = Math.max(0.1, ...data.motions.map((each) => each.ranges[3][1])) * 0.75;
  data.motions.forEach((each) => choice.add(new Option(each.deployment)));
  choice.selectedIndex = data.motions.length - 1;
  const charts = [...new Set(data.signals.map(([, unit]) => unit))].map(makeChart);
  choice.addEventListener("change", choose);
  play.addEventListener("click", () => run(!playing));
  slider.addEventListener("input", () => go(Number(slider.value)));
  for (const control of [zoom, follow]) control.addEventListener("input", draw);
  canvas.addEventListener("pointerdown", (event) => {
    drag = [event.clientX, event.clientY, azimuth, elevation];
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!drag) return;
    azimuth = drag[2] - (event.clientX - drag[0]) * 0.008;
    elevation = Math.max(-0.2, Math.min(1.57, drag[3] + (event.clientY - drag[1]) * 0.008));
    draw();
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => (drag = null));
  canvas.addEventListener("keydown", (event) => {
    const by = {ArrowLeft: -1, ArrowRight: 1, PageUp: 100, PageDown: -100}[event.key];
    if (by) {
      event.preventDefault();
      go(frame + by);
    }
  });
  new ResizeObserver(draw).observe(canvas);
  choose();
})();
