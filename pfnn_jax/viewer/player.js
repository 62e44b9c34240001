// Plays motion clips side by side, in step: capsule bodies on a ground grid, drawn on plain 2D canvases.
// Drag to orbit, Ctrl + wheel to zoom, space to pause. No outside resources.
(() => {
  "use strict";
  const TAU = 2 * Math.PI;
  const DEFAULT_VIEW = { yaw: 0.75, pitch: 0.28, distance: 4.6 };

  function decode(track) {
    const bytes = Uint8Array.from(atob(track.points), (c) => c.charCodeAt(0));
    const view = new DataView(bytes.buffer);
    const values = new Float32Array(bytes.length / 2);
    for (let i = 0; i < values.length; i++) values[i] = view.getInt16(2 * i, true) * track.unit;
    const frames = values.length / (3 * track.count);
    return { ...track, values, frames, focus: smoothRoot(values, track.count, frames) };
  }

  // The camera follows a running average of the root, so that it does not sway with every step.
  function smoothRoot(values, count, frames) {
    const focus = new Float32Array(2 * frames);
    for (let t = 0; t < frames; t++) {
      const half = Math.min(15, t, frames - 1 - t); // even on both sides, or it would lag at the ends
      const first = t - half, last = t + half;
      for (let k = first; k <= last; k++) {
        focus[2 * t] += values[3 * count * k] / (last - first + 1);
        focus[2 * t + 1] += values[3 * count * k + 2] / (last - first + 1);
      }
    }
    return focus;
  }

  function mix(hex, other, share) {
    const part = (text, i) => parseInt(text.slice(1 + 2 * i, 3 + 2 * i), 16);
    const channel = (i) => Math.round(part(hex, i) + share * (part(other, i) - part(hex, i)));
    return `rgb(${channel(0)},${channel(1)},${channel(2)})`;
  }

  function palette(element) {
    const style = getComputedStyle(element);
    const read = (name) => style.getPropertyValue(name).trim();
    const tones = {};
    for (const side of ["left", "right", "middle"]) {
      const base = read(`--player-${side}`);
      tones[side] = [mix(base, "#ffffff", 0.35), base, mix(base, "#000000", 0.38)];
    }
    return { tones, grid: read("--player-grid"), ink: read("--player-ink"), shadow: read("--player-shadow") };
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
      this.aim(camera, blend(track.focus, 2, 0), blend(track.focus, 2, 1));
      const points = [];
      for (let p = 0; p < track.count; p++) {
        points.push([0, 1, 2].map((axis) => blend(track.values, 3 * track.count, 3 * p + axis)));
      }
      context.clearRect(0, 0, this.canvas.width, this.canvas.height);
      this.grid(colours);
      this.trail(before, colours);
      this.shadow(points, colours);
      this.body(points, colours);
      if (track.phase) this.dial(track.phase[before], colours);
    }

    aim(camera, x, z) {
      const { width, height } = this.canvas;
      this.target = [x, 0.88 * this.track.tall, z];
      this.sines = [Math.cos(camera.yaw), Math.sin(camera.yaw), Math.cos(camera.pitch), Math.sin(camera.pitch)];
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
      const cx = Math.round(this.target[0]), cz = Math.round(this.target[2]);
      context.strokeStyle = colours.grid;
      context.lineWidth = window.devicePixelRatio || 1;
      for (let i = -reach; i <= reach; i++) {
        for (let j = -reach; j < reach; j++) {
          const fade = 1 - Math.hypot(cx + i - this.target[0], cz + j + 0.5 - this.target[2]) / reach;
          if (fade > 0) this.segment([cx + i, cz + j], [cx + i, cz + j + 1], fade);
          const other = 1 - Math.hypot(cx + j + 0.5 - this.target[0], cz + i - this.target[2]) / reach;
          if (other > 0) this.segment([cx + j, cz + i], [cx + j + 1, cz + i], other);
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
      for (const [first, last, alpha] of [[0, now, 0.55], [now, track.frames - 1, 0.18]]) {
        context.globalAlpha = alpha;
        context.beginPath();
        let open = false;
        for (let t = first; t <= last; t += 3) {
          const p = this.project(track.focus[2 * t], 0, track.focus[2 * t + 1]);
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

    body(points, colours) {
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
        context.fillStyle = this.shade(a, b, Math.max(ra, rb), colours.tones[capsule[4]]);
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

  // Contacts over time: one row a foot, filled while it stands, and a line for now.
  function drawTrack(canvas, track, time, duration, colours) {
    const ratio = window.devicePixelRatio || 1, context = canvas.getContext("2d");
    canvas.width = Math.round(canvas.clientWidth * ratio);
    canvas.height = Math.round(canvas.clientHeight * ratio);
    const row = canvas.height / 2, step = canvas.width / (duration * track.fps);
    track.contacts.forEach((runs, foot) => {
      context.fillStyle = colours.tones[foot ? "right" : "left"][1];
      for (const [first, last] of runs) context.fillRect(first * step, foot * row + 1, (last - first) * step, row - 2);
    });
    context.fillStyle = colours.ink;
    context.fillRect(Math.min(canvas.width - 2, (time / duration) * canvas.width), 0, 2 * ratio, canvas.height);
  }

  class Player {
    constructor(root) {
      const data = JSON.parse(root.querySelector("script[type='application/json']").textContent);
      this.root = root;
      this.tracks = data.tracks.map(decode);
      this.duration = Math.max(...this.tracks.map((track) => (track.frames - 1) / track.fps), 1e-3);
      this.camera = { ...DEFAULT_VIEW };
      this.scenes = [...root.querySelectorAll("canvas.scene")].map((canvas, i) => new Scene(canvas, this.tracks[i]));
      this.strips = [...root.querySelectorAll("canvas.contacts")].map((c) => [c, this.tracks[Number(c.dataset.track)]]);
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

    recolour() {
      this.colours = palette(this.root);
      this.draw();
    }

    play(on) {
      if (on === this.playing) return;
      this.playing = on;
      this.button.textContent = on ? "Pause" : "Play";
      if (!on) return;
      let last = performance.now();
      const tick = (now) => {
        if (!this.playing) return;
        this.time = (this.time + ((now - last) / 1000) * Number(this.rate.value)) % this.duration;
        last = now;
        this.draw();
        requestAnimationFrame(tick);
      };
      requestAnimationFrame(tick);
    }

    draw() {
      for (const scene of this.scenes) scene.draw(this.time, this.camera, this.colours);
      for (const [canvas, track] of this.strips) drawTrack(canvas, track, this.time, this.duration, this.colours);
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
