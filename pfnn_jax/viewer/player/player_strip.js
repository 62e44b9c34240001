// Time line of contacts and phases: a bar while a foot is down, a line that rises from 0 to 2π in every cycle.

const WINDOW = 10; // seconds of a time line; for longer clips it shows the part around the present moment
const GUTTER = 62; // pixels for the names of the rows
const FOOT_ROW = 11, PHASE_ROW = 30, BONE_ROW = 17, ROW_GAP = 3;

class Strip {
  constructor(canvas, clip, duration) {
    Object.assign(this, { canvas, clip, duration, context: canvas.getContext("2d") });
    const line = clip.phases.length > 1 ? BONE_ROW : PHASE_ROW;
    this.heights = [...clip.contacts.map(() => FOOT_ROW), ...clip.phases.map(() => line)];
    canvas.style.height = `${this.heights.reduce((sum, height) => sum + height + ROW_GAP, 0) + 14}px`;
  }

  // Returns the first second shown: the present is in the middle unless an end of the clip is near.
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
    const ratio = window.devicePixelRatio || 1, { canvas, context, clip } = this;
    canvas.width = Math.round(canvas.clientWidth * ratio);
    canvas.height = Math.round(canvas.clientHeight * ratio);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const width = canvas.clientWidth - GUTTER, from = this.from(time), span = this.span();
    this.x = (second) => GUTTER + ((second - from) / span) * width;
    context.font = "11px system-ui, sans-serif";
    context.textBaseline = "middle";
    const ends = Math.max(0, Math.min(this.x(clip.end) - GUTTER, width)); // nothing is known about the time after the clip
    const names = [...clip.contacts.map((_, i) => (i ? "right foot" : "left foot")), ...clip.phases.map((p) => p.name)];
    let top = 0;
    this.heights.forEach((height, row) => {
      context.globalAlpha = 1;
      context.fillStyle = colours.muted;
      context.fillText(names[row], 0, top + height / 2);
      const foot = row < clip.contacts.length;
      if (!foot && height === PHASE_ROW) this.scale(top, height);
      context.fillStyle = colours.panel;
      context.fillRect(GUTTER, top, ends, height);
      context.save();
      context.beginPath();
      context.rect(GUTTER, top, ends, height);
      context.clip();
      if (foot) this.bars(clip.contacts[row], top, height, colours[row ? "right" : "left"]);
      else this.line(clip.phases[row - clip.contacts.length], top, height, from, span, colours);
      context.restore();
      top += height + ROW_GAP;
    });
    this.seconds(top, from, span, colours);
    context.fillStyle = colours.ink;
    context.fillRect(this.x(Math.min(time, this.duration)) - 0.75, 0, 1.5, top - ROW_GAP);
  }

  // Labels the lower and the upper edge of a phase's row.
  scale(top, height) {
    const { context } = this;
    context.font = "9px system-ui, sans-serif";
    context.textAlign = "right";
    context.fillText("2π", GUTTER - 4, top + 5);
    context.fillText("0", GUTTER - 4, top + height - 4);
    context.font = "11px system-ui, sans-serif";
    context.textAlign = "left";
  }

  bars(runs, top, height, colour) {
    const { context, clip } = this;
    context.fillStyle = colour;
    for (const [first, past] of runs) {
      const left = this.x(first / clip.fps);
      context.fillRect(left, top, this.x(past / clip.fps) - left, height);
    }
  }

  line(phase, top, height, from, span, colours) {
    const { context, clip } = this, { angle, weight } = phase;
    const first = Math.max(0, Math.floor(from * clip.fps)), last = Math.min(angle.length - 2, Math.ceil((from + span) * clip.fps));
    const y = (value) => top + height - 1.5 - (value / TAU) * (height - 3);
    context.strokeStyle = colours.phase;
    context.lineWidth = 1.6;
    for (let t = first; t <= last; t++) {
      if (angle[t] === null || angle[t + 1] === null || Math.abs(angle[t + 1] - angle[t]) > TAU / 2) continue;
      context.globalAlpha = weight ? weight[t] : 1;
      context.beginPath();
      context.moveTo(this.x(t / clip.fps), y(angle[t]));
      context.lineTo(this.x((t + 1) / clip.fps), y(angle[t + 1]));
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
