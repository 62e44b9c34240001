// Plays motion clips next to each other, in step. Follows the other scripts; no outside resources.
// Drag to orbit, Ctrl + wheel to zoom, space to pause, arrow keys for single frames, press on a time line to jump there.

const DEFAULT_VIEW = { yaw: 0.75, pitch: 0.28, distance: 4.6 };
const SLOW = 60; // milliseconds: when pictures take longer, as without a graphics card, they get fewer pixels
const COARSER = 0.7, COARSEST = 0.5; // pixels drawn per pixel shown: by how much fewer, and how few at the least

class Player {
  static async load(root) {
    const data = JSON.parse(root.querySelector("script[type='application/json']").textContent);
    const THREE = await loadRenderer();
    sharedRenderer(THREE); // fails where a browser has no WebGL
    const meshes = await Promise.all(data.meshes.map((mesh) => loadMesh(THREE, mesh)));
    return new Player(root, THREE, await Promise.all(data.clips.map(loadClip)), meshes);
  }

  constructor(root, THREE, clips, meshes) {
    this.root = root;
    this.clips = clips;
    this.duration = Math.max(...this.clips.map((clip) => (clip.frames - 1) / clip.fps), 1e-3);
    this.camera = { ...DEFAULT_VIEW };
    const scene = (canvas, i) => new Scene(THREE, canvas, clips[i], meshes[clips[i].mesh]);
    this.scenes = [...root.querySelectorAll("canvas.scene")].map(scene);
    const strip = (canvas) => new Strip(canvas, this.clips[Number(canvas.dataset.clip)], this.duration);
    this.strips = [...root.querySelectorAll("canvas.strip")].map(strip);
    this.button = root.querySelector("button.play");
    this.slider = root.querySelector("input[type=range]");
    this.clock = root.querySelector("output");
    this.rate = root.querySelector("select");
    this.time = 0;
    this.playing = false;
    this.sharpness = 1;
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
      const direction = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (event.target !== this.root || (event.key !== " " && !direction)) return;
      event.preventDefault();
      if (direction) this.step(direction);
      else this.play(!this.playing);
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

  // Jumps to the moment pressed on a time line.
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

  // Steps to the next or the previous frame of the clip with the highest frame rate.
  step(direction) {
    this.play(false);
    const fps = Math.max(...this.clips.map((clip) => clip.fps));
    const now = this.time * fps, near = 1e-3; // of a frame: a time this close to a frame is that frame's
    const frame = direction > 0 ? Math.floor(now + near) + 1 : Math.ceil(now - near) - 1;
    this.time = Math.max(0, Math.min(this.duration, frame / fps));
    this.draw();
  }

  recolour() {
    this.colours = palette(this.root);
    for (const scene of this.scenes) scene.recolour(this.colours);
    this.draw();
  }

  play(on) {
    if (on === this.playing || this.clips.every((clip) => clip.frames < 2)) return;
    this.playing = on;
    this.button.textContent = on ? "Pause" : "Play";
    if (!on) return;
    let last; // the browser's time of the last animation frame
    const tick = (now) => {
      if (!this.playing) return;
      this.time = (this.time + ((now - (last ?? now)) / 1000) * Number(this.rate.value)) % this.duration;
      this.coarsen(now - (last ?? now));
      last = now;
      this.draw();
      requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  // Draws fewer pixels when the average time between pictures is too long.
  coarsen(passed) {
    this.passed = 0.9 * (this.passed ?? 0) + 0.1 * Math.min(passed, 4 * SLOW); // a single long one is no reason
    if (this.passed < SLOW || this.sharpness <= COARSEST) return;
    this.sharpness = Math.max(COARSEST, COARSER * this.sharpness);
    this.passed = 0;
  }

  draw() {
    const sharpness = this.playing ? this.sharpness : 1;
    for (const scene of this.scenes) scene.draw(this.time, this.camera, this.colours, sharpness);
    for (const strip of this.strips) strip.draw(this.time, this.colours);
    this.slider.value = (1000 * this.time) / this.duration;
    this.clock.textContent = `${this.time.toFixed(2)} / ${this.duration.toFixed(2)} s`;
  }
}

// Says in the scenes' place why nothing can be drawn, such as a browser without WebGL.
function explain(root, error) {
  for (const canvas of root.querySelectorAll("canvas.scene")) {
    const note = document.createElement("p");
    note.className = "failure";
    note.textContent = `This browser cannot draw the motion: ${error.message}`;
    canvas.replaceWith(note);
  }
}

// Loads players when they come near the window: a report may hold many.
const start = () => {
  const near = new IntersectionObserver((entries) => {
    for (const { target: root, isIntersecting } of entries) {
      if (!isIntersecting) continue;
      near.unobserve(root);
      Player.load(root).then(() => (root.dataset.started = "yes"), (error) => explain(root, error));
    }
  }, { rootMargin: "200px" });
  document.querySelectorAll(".motion-player").forEach((root) => near.observe(root));
};
if (document.readyState === "loading") document.addEventListener("DOMContentLoaded", start);
else start();
