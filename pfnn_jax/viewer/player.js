// Plays motion clips side by side, in step: capsule bodies on a ground grid, drawn on plain 2D canvases.
// Drag to orbit, Ctrl + wheel to zoom, space to pause, press on a time line to go there. No outside resources.
(() => {
  "use strict";
  const TAU = 2 * Math.PI;
  const DEFAULT_VIEW = { yaw: 0.75, pitch: 0.28, distance: 4.6 };

  const WINDOW = 10; // seconds of a time line; of longer clips it shows the part around now
  const GUTTER = 62; // pixels for the names of its rows
  const FOOT_ROW = 11, PHASE_ROW = 30, BONE_ROW = 17, ROW_GAP = 3;
  const TRAIL = 20; // seconds of the path drawn before and after now

  function numbers(text, unit) {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const view = new DataView(bytes.buffer);
    const values = new Float32Array(bytes.length / 2);
    for (let i = 0; i < values.length; i++) values[i] = view.getInt16(2 * i, true) * unit;
    return values;
  }

  function decode(track) {
    const values = numbers(track.points, track.unit), focus = numbers(track.focus, track.unit);
    return { ...track, values, focus, frames: focus.length / 3 };
  }

  function mix(hex, other, share) {
    const part = (text, i) => parseInt(text.slice(1 + 2 * i, 3 + 2 * i), 16);
    const channel = (i) => Math.round(part(hex, i) + share * (part(other, i) - part(hex, i)));
    return `rgb(${channel(0)},${channel(1)},${channel(2)})`;
  }

  function palette(element) {
    const style = getComputedStyle(element);
    const read = (name) => style.getPropertyValue(name).trim();
    const tones = {}, pale = {}, panel = read("--player-panel");
    for (const side of ["left", "right", "middle"]) {
      const base = read(`--player-${side}`);
      tones[side] = [mix(base, "#ffffff", 0.35), base, mix(base, "#000000", 0.38)];
      pale[side] = [0.85, 0.65, 0.5].map((share) => mix(base, panel, share));
    }
    const named = {};
    for (const name of ["grid", "ink", "shadow", "muted", "panel", "phase"]) named[name] = read(`--player-${name}`);
    return { tones, pale, ...named };
  }

  class Scene {
    constructor(canvas, track) {
      this.canvas = canvas;
      this.track = track;
      this.context = canvas.getContext("2d");
    }

    resize() {
      const ratio = window.devicePixelRatio || 1;
      const width = Math.round(this.canvas.clientWidth * ratio), height = Math.round(this.canvas.clientHeight * ratio);
      if (this.canvas.width !== width || this.canvas.height !== height) {
        this.canvas.width = width;
        this.canvas.height = height;
      }
    }

    draw(time, camera, colours) {
      this.resize();
      const { track, context } = this;
      const frame = Math.min(time * track.fps, track.frames - 1);
      const before = Math.floor(frame), after = Math.min(before + 1, track.frames - 1), share = frame - before;
      const blend = (array, stride, offset) =>
        (1 - share) * array[stride * before + offset] + share * array[stride * after + offset];
      this.aim(camera, [0, 1, 2].map((axis) => blend(track.focus, 3, axis)));
      const points = [];
      for (let p = 0; p < track.count; p++) {
        points.push([0, 1, 2].map((axis) => blend(track.values, 3 * track.count, 3 * p + axis)));
      }
      context.clearRect(0, 0, this.canvas.width, this.canvas.height);
      this.grid(colours);
      this.trail(before, colours);
      this.shadow(points, colours);
      const over = time * track.fps > track.frames; // a clip that has ended waits for the others
      this.body(points, over ? colours.pale : colours.tones);
      if (track.phases.length === 1 && track.phases[0].angle[before] !== null) {
        this.dial(track.phases[0].angle[before], colours);
      }
    }

    aim(camera, target) {
      const { width, height } = this.canvas, yaw = camera.yaw + this.track.heading;
      this.target = target;
      this.sines = [Math.cos(yaw), Math.sin(yaw), Math.cos(camera.pitch), Math.sin(camera.pitch)];
      this.distance = camera.distance * this.track.tall;
      this.zoom = 1.75 * Math.min(height, 1.25 * width);
    }

    // Screen position and pixels per metre; null behind the eye.
    project(x, y, z) {
      const [cy, sy, cp, sp] = this.sines;
      const dx = x - this.target[0], dy = y - this.target[1], dz = z - this.target[2];
      const right = cy * dx - sy * dz, ahead = sy * dx + cy * dz;
      const up = cp * dy - sp * ahead, near = sp * dy + cp * ahead;
      const away = this.distance - near;
      if (away < 0.2) return null;
      const scale = this.zoom / away;
      return [this.canvas.width / 2 + right * scale, this.canvas.height / 2 - up * scale, scale, near];
    }

    grid(colours) {
      const { context } = this, reach = 7;
      const step = this.track.tall > 3 || this.track.tall < 0.3 ? 10 ** Math.round(Math.log10(this.track.tall)) : 1;
      const cx = Math.round(this.target[0] / step), cz = Math.round(this.target[2] / step);
      context.strokeStyle = colours.grid;
      context.lineWidth = window.devicePixelRatio || 1;
      for (let i = -reach; i <= reach; i++) {
        for (let j = -reach; j < reach; j++) {
          for (const [x, z, dx, dz] of [[cx + i, cz + j, 0, 1], [cx + j, cz + i, 1, 0]]) {
            const away = Math.hypot(x + dx / 2 - this.target[0] / step, z + dz / 2 - this.target[2] / step);
            if (away < reach) this.segment([x * step, z * step], [(x + dx) * step, (z + dz) * step], 1 - away / reach);
          }
        }
      }
      context.globalAlpha = 1;
    }

    segment(from, to, alpha) {
      const a = this.project(from[0], 0, from[1]), b = this.project(to[0], 0, to[1]);
      if (!a || !b) return;
      const { context } = this;
      context.globalAlpha = alpha;
      context.beginPath();
      context.moveTo(a[0], a[1]);
      context.lineTo(b[0], b[1]);
      context.stroke();
    }

    trail(now, colours) {
      const { context, track } = this;
      context.strokeStyle = colours.ink;
      context.lineWidth = 2 * (window.devicePixelRatio || 1);
      const reach = Math.round(TRAIL * track.fps), every = Math.max(1, Math.round(track.fps / 10));
      const past = Math.max(0, now - reach), future = Math.min(track.frames - 1, now + reach);
      for (const [first, last, alpha] of [[past, now, 0.55], [now, future, 0.18]]) {
        context.globalAlpha = alpha;
        context.beginPath();
        let open = false;
        for (let step = first; step < last + every; step += every) {
          const t = Math.min(step, last);
          const p = this.project(track.focus[3 * t], 0, track.focus[3 * t + 2]);
          if (p) open ? context.lineTo(p[0], p[1]) : context.moveTo(p[0], p[1]);
          open = Boolean(p);
        }
        context.stroke();
      }
      context.globalAlpha = 1;
    }

    ends(points, capsule) {
      const [start, end, , , , from, to] = capsule;
      const at = (share) => points[start].map((value, axis) => value + share * (points[end][axis] - value));
      return [at(from), at(to)];
    }

    shadow(points, colours) {
      const { context } = this;
      context.fillStyle = colours.shadow;
      context.beginPath();
      for (const capsule of this.track.capsules) {
        const [a, b] = this.ends(points, capsule).map((p) => this.project(p[0], 0, p[2]));
        if (a && b) this.hull(a, b, capsule[2] * a[2] * 0.9, capsule[3] * b[2] * 0.9, Math.max(0.25, this.sines[3]));
      }
      context.fill();
    }

    body(points, tones) {
      const drawn = [];
      for (const capsule of this.track.capsules) {
        const [a, b] = this.ends(points, capsule).map((p) => this.project(...p));
        if (a && b) drawn.push({ a, b, capsule, depth: a[3] + b[3] });
      }
      drawn.sort((one, two) => one.depth - two.depth);
      const { context } = this;
      for (const { a, b, capsule } of drawn) {
        const ra = capsule[2] * a[2], rb = capsule[3] * b[2];
        context.beginPath();
        this.hull(a, b, ra, rb, 1);
        context.fillStyle = this.shade(a, b, Math.max(ra, rb), tones[capsule[4]]);
        context.fill();
      }
    }

    // Light from above left: a gradient across the limb makes it round.
    shade(a, b, radius, tones) {
      const length = Math.hypot(b[0] - a[0], b[1] - a[1]);
      let nx = -0.5, ny = -0.85;
      if (length > radius) {
        nx = -(b[1] - a[1]) / length;
        ny = (b[0] - a[0]) / length;
        if (0.5 * nx + 0.85 * ny > 0) [nx, ny] = [-nx, -ny];
      }
      const x = (a[0] + b[0]) / 2, y = (a[1] + b[1]) / 2;
      const gradient = this.context.createLinearGradient(x + nx * radius, y + ny * radius, x - nx * radius, y - ny * radius);
      tones.forEach((tone, i) => gradient.addColorStop([0, 0.45, 1][i], tone));
      return gradient;
    }

    // Adds the outline around two circles to the current path, flattened vertically by `flat`.
    hull(a, b, ra, rb, flat) {
      const { context } = this;
      const dx = b[0] - a[0], dy = (b[1] - a[1]) / flat, length = Math.hypot(dx, dy);
      const draw = (x, y, r, from, to) => context.ellipse(x, y, r, r * flat, 0, from, to);
      if (length <= Math.abs(ra - rb) + 0.01) {
        const [p, r] = ra > rb ? [a, ra] : [b, rb];
        context.moveTo(p[0] + r, p[1]);
        draw(p[0], p[1], r, 0, TAU);
        return;
      }
      const angle = Math.atan2(dy, dx), spread = Math.acos((ra - rb) / length);
      context.moveTo(a[0] + ra * Math.cos(angle + spread), a[1] + flat * ra * Math.sin(angle + spread));
      draw(a[0], a[1], ra, angle + spread, angle - spread + TAU);
      draw(b[0], b[1], rb, angle - spread, angle + spread);
      context.closePath();
    }

    // The phase as a clock hand: up is right contact, down left contact.
    dial(phase, colours) {
      const { context } = this, ratio = window.devicePixelRatio || 1;
      const r = 13 * ratio, x = this.canvas.width - r - 10 * ratio, y = r + 10 * ratio;
      context.lineWidth = 1.5 * ratio;
      context.strokeStyle = colours.grid;
      context.beginPath();
      context.arc(x, y, r, 0, TAU);
      context.stroke();
      context.strokeStyle = Math.cos(phase) > 0 ? colours.tones.right[1] : colours.tones.left[1];
      context.beginPath();
      context.moveTo(x, y);
      context.lineTo(x + r * Math.sin(phase), y - r * Math.cos(phase));
      context.stroke();
    }
  }

  // Contacts and phases over time: a bar while a foot stands, a line rising from 0 to 2π with every cycle.
  class Strip {
    constructor(canvas, track, duration) {
      Object.assign(this, { canvas, track, duration, context: canvas.getContext("2d") });
      const line = track.phases.length > 1 ? BONE_ROW : PHASE_ROW;
      this.heights = [...track.contacts.map(() => FOOT_ROW), ...track.phases.map(() => line)];
      canvas.style.height = `${this.heights.reduce((sum, height) => sum + height + ROW_GAP, 0) + 14}px`;
    }

    // First second shown, so that now is in the middle unless an end of the clip is near.
    from(time) {
      return Math.max(0, Math.min(time - WINDOW / 2, this.duration - WINDOW));
    }

    span() {
      return Math.min(this.duration, WINDOW);
    }

    timeAt(x, time) {
      const share = (x - GUTTER) / (this.canvas.clientWidth - GUTTER);
      return Math.max(0, Math.min(this.duration, this.from(time) + share * this.span()));
    }

    draw(time, colours) {
      const ratio = window.devicePixelRatio || 1, { canvas, context, track } = this;
      canvas.width = Math.round(canvas.clientWidth * ratio);
      canvas.height = Math.round(canvas.clientHeight * ratio);
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
      const width = canvas.clientWidth - GUTTER, from = this.from(time), span = this.span();
      this.x = (second) => GUTTER + ((second - from) / span) * width;
      context.font = "11px system-ui, sans-serif";
      context.textBaseline = "middle";
      const names = [...track.contacts.map((_, i) => (i ? "right foot" : "left foot")), ...track.phases.map((p) => p.name)];
      let top = 0;
      this.heights.forEach((height, row) => {
        context.globalAlpha = 1;
        context.fillStyle = colours.muted;
        context.fillText(names[row], 0, top + height / 2);
        const foot = row < track.contacts.length;
        context.fillStyle = colours.panel;
        context.fillRect(GUTTER, top, width, height);
        context.save();
        context.beginPath();
        context.rect(GUTTER, top, width, height);
        context.clip();
        if (foot) this.bars(track.contacts[row], top, height, colours.tones[row ? "right" : "left"][1]);
        else this.line(track.phases[row - track.contacts.length], top, height, from, span, colours);
        context.restore();
        top += height + ROW_GAP;
      });
      this.seconds(top, from, span, colours);
      context.fillStyle = colours.ink;
      context.fillRect(this.x(Math.min(time, this.duration)) - 0.75, 0, 1.5, top - ROW_GAP);
    }

    bars(runs, top, height, colour) {
      const { context, track } = this;
      context.fillStyle = colour;
      for (const [first, past] of runs) {
        const left = this.x(first / track.fps);
        context.fillRect(left, top, this.x(past / track.fps) - left, height);
      }
    }

    line(phase, top, height, from, span, colours) {
      const { context, track } = this, { angle, weight } = phase;
      const first = Math.max(0, Math.floor(from * track.fps)), last = Math.min(angle.length - 2, Math.ceil((from + span) * track.fps));
      const y = (value) => top + height - 1.5 - (value / TAU) * (height - 3);
      context.strokeStyle = colours.phase;
      context.lineWidth = 1.6;
      for (let t = first; t <= last; t++) {
        if (angle[t] === null || angle[t + 1] === null || Math.abs(angle[t + 1] - angle[t]) > TAU / 2) continue;
        context.globalAlpha = weight ? weight[t] : 1;
        context.beginPath();
        context.moveTo(this.x(t / track.fps), y(angle[t]));
        context.lineTo(this.x((t + 1) / track.fps), y(angle[t + 1]));
        context.stroke();
      }
    }

    seconds(top, from, span, colours) {
      const { context } = this, every = span > 5 ? 2 : span > 2 ? 1 : span > 1 ? 0.5 : 0.2;
      context.globalAlpha = 1;
      context.fillStyle = colours.muted;
      for (let k = Math.ceil(from / every - 1e-9); k * every <= from + span + 1e-9; k++) {
        const text = `${Number((k * every).toFixed(1))} s`, half = context.measureText(text).width / 2;
        const x = Math.max(GUTTER + half, this.x(k * every));
        if (x + half <= this.canvas.clientWidth) context.fillText(text, x - half, top + 6);
      }
    }
  }

  class Player {
    constructor(root) {
      const data = JSON.parse(root.querySelector("script[type='application/json']").textContent);
      this.root = root;
      this.tracks = data.tracks.map(decode);
      this.duration = Math.max(...this.tracks.map((track) => (track.frames - 1) / track.fps), 1e-3);
      this.camera = { ...DEFAULT_VIEW };
      this.scenes = [...root.querySelectorAll("canvas.scene")].map((canvas, i) => new Scene(canvas, this.tracks[i]));
      const strip = (canvas) => new Strip(canvas, this.tracks[Number(canvas.dataset.track)], this.duration);
      this.strips = [...root.querySelectorAll("canvas.strip")].map(strip);
      this.button = root.querySelector("button.play");
      this.slider = root.querySelector("input[type=range]");
      this.clock = root.querySelector("output");
      this.rate = root.querySelector("select");
      this.time = Math.min(data.start, this.duration);
      this.playing = false;
      this.listen();
      this.recolour();
    }

    listen() {
      this.button.addEventListener("click", () => this.play(!this.playing));
      this.slider.addEventListener("input", () => {
        this.time = (this.slider.value / 1000) * this.duration;
        this.draw();
      });
      this.root.querySelector("button.reset").addEventListener("click", () => {
        Object.assign(this.camera, DEFAULT_VIEW);
        this.draw();
      });
      this.root.addEventListener("keydown", (event) => {
        if (event.key !== " " || event.target !== this.root) return;
        event.preventDefault();
        this.play(!this.playing);
      });
      for (const scene of this.scenes) this.orbit(scene.canvas);
      for (const strip of this.strips) this.seek(strip);
      matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.recolour());
      new ResizeObserver(() => this.draw()).observe(this.root);
      const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
      new IntersectionObserver((entries) => {
        const visible = entries[0].isIntersecting;
        if (visible && this.resume === undefined) this.resume = !still;
        if (visible) this.play(this.resume);
        else {
          this.resume = this.resume === undefined ? undefined : this.playing;
          this.play(false);
        }
      }, { threshold: 0.1 }).observe(this.root);
    }

    orbit(canvas) {
      canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
      canvas.addEventListener("pointermove", (event) => {
        if (!canvas.hasPointerCapture(event.pointerId)) return;
        this.camera.yaw -= 0.008 * event.movementX;
        this.camera.pitch = Math.min(1.5, Math.max(0.02, this.camera.pitch + 0.006 * event.movementY));
        this.draw();
      });
      canvas.addEventListener("wheel", (event) => {
        if (!event.ctrlKey && !event.metaKey) return;
        event.preventDefault();
        this.camera.distance = Math.min(15, Math.max(2, this.camera.distance * Math.exp(0.001 * event.deltaY)));
        this.draw();
      }, { passive: false });
    }

    // Press on a time line to go there.
    seek(strip) {
      const go = (event) => {
        this.time = strip.timeAt(event.offsetX, this.time);
        this.draw();
      };
      strip.canvas.addEventListener("pointerdown", (event) => {
        this.play(false);
        strip.canvas.setPointerCapture(event.pointerId);
        go(event);
      });
      strip.canvas.addEventListener("pointermove", (event) => {
        if (strip.canvas.hasPointerCapture(event.pointerId) && this.duration <= WINDOW) go(event);
      });
    }

    recolour() {
      this.colours = palette(this.root);
      this.draw();
    }

    play(on) {
      if (on === this.playing || this.tracks.every((track) => track.frames < 2)) return;
      this.playing = on;
      this.button.textContent = on ? "Pause" : "Play";
      if (!on) return;
      let last; // the first frame's own time, which may lie before this call
      const tick = (now) => {
        if (!this.playing) return;
        this.time = (this.time + ((now - (last ?? now)) / 1000) * Number(this.rate.value)) % this.duration;
        last = now;
        this.draw();
        requestAnimationFrame(tick);
      };
      requestAnimationFrame(tick);
    }

    draw() {
      for (const scene of this.scenes) scene.draw(this.time, this.camera, this.colours);
      for (const strip of this.strips) strip.draw(this.time, this.colours);
      this.slider.value = (1000 * this.time) / this.duration;
      this.clock.textContent = `${this.time.toFixed(1)} / ${this.duration.toFixed(1)} s`;
    }
  }

  const start = () => document.querySelectorAll(".motion-player").forEach((root) => {
    if (!root.dataset.started) new Player(root);
    root.dataset.started = "yes";
  });
  if (document.readyState === "loading") document.addEventListener("DOMContentLoaded", start);
  else start();
})();
