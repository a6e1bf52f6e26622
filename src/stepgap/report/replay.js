"use strict";
// Draws the hopper of #replay-data on #replay-canvas: parallel projection, z up, the boom's pivot over the origin.
(() => {
  const at = (name) => document.getElementById("replay-" + name);
  const data = JSON.parse(at("data").textContent);
  const canvas = at("canvas"), slider = at("slider"), play = at("play"), moment = at("moment");
  const choice = at("deployment"), speed = at("speed"), zoom = at("zoom"), follow = at("follow");
  const [top_, bottom, toe] = data.leg, radius = data.boom;
  const MARKS = 12, TRAIL = 120, TICKS = 144;
  let motion = null, frame = 0, playing = false, before = 0, azimuth = -1.15, elevation = 0.22, drag = null;

  function unpacked(source) {
    const bytes = Uint8Array.from(atob(source.packed), (letter) => letter.charCodeAt(0));
    const whole = new DataView(bytes.buffer), found = {frames: source.frames, rate: source.rate, deployment: source.deployment};
    source.channels.forEach((name, row) => {
      const [low, high] = source.ranges[row], values = new Float64Array(source.frames);
      for (let i = 0; i < source.frames; i++)
        values[i] = low + (high - low) * whole.getUint16(2 * (row * source.frames + i), true) / data.levels;
      found[name] = name === "step" ? values.map(Math.round) : values;
    });
    found.steps = new Map(source.steps.map((step) => [step[0], step.slice(1)]));
    found.ends = new Map();
    for (let i = 1; i < source.frames; i++) if (found.step[i] !== found.step[i - 1]) found.ends.set(found.step[i - 1], i - 1);
    if (found.steps.has(found.step[source.frames - 1])) found.ends.set(found.step[source.frames - 1], source.frames - 1);
    return found;
  }

  // Point on the circle, in the leg's plane: along is forward, up is height.
  function pointAt(yaw, along, up) {
    return [radius * Math.sin(yaw) + along * Math.cos(yaw), -radius * Math.cos(yaw) + along * Math.sin(yaw), up];
  }

  function leg(i) {
    const yaw = motion.travel[i] / radius, height = motion.height[i];
    const middle = motion.alpha_1[i], half = motion.alpha_2[i];
    const knee = Math.asin(top_ / bottom * Math.sin(half));
    const length = top_ * Math.cos(half) + bottom * Math.cos(knee);
    const polar = (size, angle) => [size * Math.sin(angle), -size * Math.cos(angle)];
    const on = ([x, y]) => pointAt(yaw, x, height + y);
    const joint = polar(length, middle), tip = polar(toe, middle + knee);
    return {
      yaw, hip: on([0, 0]), front: on(polar(top_, middle + half)), rear: on(polar(top_, middle - half)),
      joint: on(joint), foot: on([joint[0] + tip[0], joint[1] + tip[1]]),
    };
  }

  function draw() {
    const wide = canvas.clientWidth, high = canvas.clientHeight, dots = window.devicePixelRatio || 1;
    if (canvas.width !== Math.round(wide * dots) || canvas.height !== Math.round(high * dots)) {
      canvas.width = Math.round(wide * dots);
      canvas.height = Math.round(high * dots);
    }
    const pen = canvas.getContext("2d"), here = leg(frame);
    const turn = azimuth + (follow.checked ? here.yaw : 0);
    const [a, b, c, d] = [Math.cos(turn), Math.sin(turn), Math.cos(elevation), Math.sin(elevation)];
    const size = 2.4 * Math.pow(0.32 / 2.4, zoom.value / 100), scale = Math.min(wide, 1.6 * high) / (3.2 * size);
    const middle = follow.checked ? pointAt(here.yaw, 0, 0.33) : [0, 0, 0.3], near = Math.min(1, zoom.value / 60);
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

    for (const ring of [0.88, 1, 1.12]) {
      const circle = [];
      for (let i = 0; i <= TICKS; i++) {
        const angle = 2 * Math.PI * i / TICKS;
        circle.push([ring * radius * Math.sin(angle), -ring * radius * Math.cos(angle), 0]);
      }
      line(circle, ring === 1 ? "#888" : "#ccc", 1);
    }
    for (let i = 0; i < TICKS; i++) {
      const [x, y] = [Math.sin(2 * Math.PI * i / TICKS), -Math.cos(2 * Math.PI * i / TICKS)];
      line([[0.88 * radius * x, 0.88 * radius * y, 0], [1.12 * radius * x, 1.12 * radius * y, 0]], i % 12 ? "#ddd" : "#999", 1);
    }

    const step = motion.step[frame], entry = motion.steps.get(step);
    if (entry && entry[1] !== null) {
      const arc = [];
      for (let i = -20; i <= 20; i++) arc.push(pointAt(here.yaw + i * 0.02, 0, entry[1]));
      line(arc, "#000", 1, [6, 5]);
    }
    for (let number = step - MARKS; number < step + (frame === motion.ends.get(step) ? 1 : 0); number++) {
      const end = motion.ends.get(number), known = motion.steps.get(number);
      if (end === undefined || !known) continue;
      const yaw = motion.travel[end] / radius;
      line([pointAt(yaw, -0.025, known[1]), pointAt(yaw, 0.025, known[1])], "#000", 2);
      if (known[3] !== null) dot(pointAt(yaw, 0, known[3]), "#d55e00", 3.5, false);
    }
    const trail = [];
    for (let i = Math.max(0, frame - TRAIL); i <= frame; i++) trail.push(pointAt(motion.travel[i] / radius, 0, motion.height[i]));
    line(trail, "#e69f00", 1.2);

    line([[0, 0, 0], [0, 0, data.pivot]], "#555", 6);
    line([[0, 0, data.pivot], here.hip], "#555", 4);
    const stroke = Math.max(2, 0.012 * scale);
    line([here.hip, here.rear, here.joint, here.foot], "#0072b2", stroke);
    line([here.hip, here.front, here.joint], "#004a75", stroke);
    for (const pin of [here.front, here.rear, here.joint]) dot(pin, "#004a75", 0.7 * stroke, false);
    dot(here.hip, "#333", 1.6 * stroke, true);
    dot(here.foot, "#c00000", 0.9 * stroke, motion.force[frame] > 1);

    slider.value = frame;
    const time = (frame / motion.rate).toFixed(2), end = ((motion.frames - 1) / motion.rate).toFixed(2);
    moment.textContent = `deployment ${motion.deployment}, ${time} s of ${end} s: ` + (entry
      ? `step ${step} of ${motion.last}. Target ${format(entry[0], "m/s")}, ${format(entry[1], "m")}; ` +
        `reached ${entry[3] === null ? "no apex" : format(entry[2], "m/s") + ", " + format(entry[3], "m")}; command ${format(entry[4], "N")}, ${format(entry[5], "N")}.`
      : "released.");
  }

  function format(value, unit) {
    return value === null ? "unknown" : value.toFixed(unit === "N" ? 1 : 3).replace("-", "\u2212") + " " + unit;
  }

  function choose() {
    motion = unpacked(data.motions[choice.selectedIndex]);
    motion.last = Math.max(...motion.steps.keys());
    slider.max = motion.frames - 1;
    frame = Math.min(frame, motion.frames - 1);
    draw();
  }

  function run(wanted) {
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
    frame = Math.max(0, Math.min(motion.frames - 1, to));
    draw();
  }

  data.motions.forEach((each) => choice.add(new Option(each.deployment)));
  choice.selectedIndex = data.motions.length - 1;
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
