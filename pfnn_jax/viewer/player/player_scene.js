// The scene of one clip: a body of capsules on a ground grid, drawn on a plain 2D canvas.

const TAU = 2 * Math.PI;
const TRAIL = 20; // seconds of the path drawn before and after the present

function numbers(text, unit) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const view = new DataView(bytes.buffer);
  const values = new Float32Array(bytes.length / 2);
  for (let i = 0; i < values.length; i++) values[i] = view.getInt16(2 * i, true) * unit;
  return values;
}

function decode(clip) {
  const values = numbers(clip.points, clip.unit), focus = numbers(clip.focus, clip.unit);
  return { ...clip, values, focus, frames: focus.length / 3 };
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
  constructor(canvas, clip) {
    this.canvas = canvas;
    this.clip = clip;
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
    const { clip, context } = this;
    const frame = Math.min(time * clip.fps, clip.frames - 1);
    const before = Math.floor(frame), after = Math.min(before + 1, clip.frames - 1), share = frame - before;
    const blend = (array, stride, offset) =>
      (1 - share) * array[stride * before + offset] + share * array[stride * after + offset];
    this.aim(camera, [0, 1, 2].map((axis) => blend(clip.focus, 3, axis)));
    const points = [];
    for (let p = 0; p < clip.count; p++) {
      points.push([0, 1, 2].map((axis) => blend(clip.values, 3 * clip.count, 3 * p + axis)));
    }
    context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    this.grid(colours);
    this.trail(before, colours);
    this.shadow(points, colours);
    const ended = time > clip.end; // longer clips go on playing
    this.body(points, ended ? colours.pale : colours.tones);
    if (ended) this.ended(colours);
    else if (clip.phases.length === 1 && clip.phases[0].angle[before] !== null) {
      this.dial(clip.phases[0].angle[before], colours);
    }
  }

  aim(camera, target) {
    const { width, height } = this.canvas, yaw = camera.yaw + this.clip.facing;
    this.target = target;
    this.sines = [Math.cos(yaw), Math.sin(yaw), Math.cos(camera.pitch), Math.sin(camera.pitch)];
    this.distance = camera.distance * this.clip.tall;
    this.zoom = 1.75 * Math.min(height, 1.25 * width);
  }

  // Returns screen position, pixels per metre and nearness; null behind the eye.
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
    const step = this.clip.tall > 3 || this.clip.tall < 0.3 ? 10 ** Math.round(Math.log10(this.clip.tall)) : 1;
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
    const { context, clip } = this;
    context.strokeStyle = colours.ink;
    context.lineWidth = 2 * (window.devicePixelRatio || 1);
    const reach = Math.round(TRAIL * clip.fps), every = Math.max(1, Math.round(clip.fps / 10));
    const past = Math.max(0, now - reach), future = Math.min(clip.frames - 1, now + reach);
    for (const [first, last, alpha] of [[past, now, 0.55], [now, future, 0.18]]) {
      context.globalAlpha = alpha;
      context.beginPath();
      let open = false;
      for (let step = first; step < last + every; step += every) {
        const t = Math.min(step, last);
        const p = this.project(clip.focus[3 * t], 0, clip.focus[3 * t + 2]);
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
    for (const capsule of this.clip.capsules) {
      const [a, b] = this.ends(points, capsule).map((p) => this.project(p[0], 0, p[2]));
      if (a && b) this.hull(a, b, capsule[2] * a[2] * 0.9, capsule[3] * b[2] * 0.9, Math.max(0.25, this.sines[3]));
    }
    context.fill();
  }

  body(points, tones) {
    const drawn = [];
    for (const capsule of this.clip.capsules) {
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

  // Adds the outline around two circles to the current path, scaled vertically by `flat`.
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

  ended(colours) {
    const { context, canvas } = this, ratio = window.devicePixelRatio || 1;
    context.font = `${12 * ratio}px system-ui, sans-serif`;
    context.textAlign = "right";
    context.textBaseline = "bottom";
    context.fillStyle = colours.muted;
    const last = (this.clip.frames - 1) / this.clip.fps;
    context.fillText(`ended at ${last.toFixed(1)} s`, canvas.width - 10 * ratio, canvas.height - 8 * ratio);
  }

  // Draws the phase as a clock hand: up is the right foot's contact, down the left foot's.
  dial(phase, colours) {
    const { context } = this, ratio = window.devicePixelRatio || 1;
    const r = 13 * ratio, x = this.canvas.width - r - 10 * ratio, y = r + 22 * ratio;
    context.font = `600 ${11 * ratio}px system-ui, sans-serif`;
    context.textAlign = "center";
    context.textBaseline = "middle";
    for (const [side, up] of [["right", 1], ["left", -1]]) {
      context.fillStyle = colours.tones[side][1];
      context.fillText(side[0].toUpperCase(), x, y - up * (r + 8 * ratio));
    }
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
