// The scene of one clip: a skinned body on a ground with its shadow and its path, drawn by three.js.

const TAU = 2 * Math.PI;
const TRAIL = 20; // seconds of the path drawn before and after the present
const REACH = 7; // steps of the ground's grid from the body to where it fades away
const SHADOWED = 1.4; // half the width of what casts a shadow, in bodies of a person's size
const SHARPEST = 2; // device pixels per pixel: more are drawn, but not seen

// The renderer that all players of a page share, because browsers allow a page few of them. A new one is made when the
// browser has taken the old one's context away.
let shared;
function sharedRenderer(THREE) {
  if (shared && !shared.getContext().isContextLost()) return shared;
  shared?.dispose();
  shared = new THREE.WebGLRenderer({ alpha: true, antialias: true });
  shared.debug.checkShaderErrors = false; // would wait for the graphics card
  shared.outputEncoding = THREE.sRGBEncoding;
  shared.shadowMap.enabled = true;
  shared.shadowMap.type = THREE.PCFShadowMap;
  return shared;
}

function palette(element) {
  const style = getComputedStyle(element), named = {};
  for (const name of ["grid", "ink", "shadow", "muted", "panel", "phase", "left", "right"]) {
    named[name] = style.getPropertyValue(`--player-${name}`).trim();
  }
  return named;
}

class Scene {
  constructor(THREE, canvas, clip, mesh) {
    Object.assign(this, { THREE, canvas, clip, context: canvas.getContext("2d") });
    this.scene = new THREE.Scene();
    this.scene.fog = new THREE.Fog(); // in which the path fades away, as the grid does
    this.camera = new THREE.PerspectiveCamera();
    this.addLight();
    this.addGround();
    this.addPath();
    this.addBody(mesh);
  }

  addLight() {
    const { THREE, scene } = this, reach = SHADOWED * this.clip.tall;
    scene.add(new THREE.HemisphereLight("#ffffff", "#aab2bf", 0.66));
    this.sun = new THREE.DirectionalLight("#ffffff", 0.75);
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(1024, 1024);
    this.sun.shadow.normalBias = 0.02 * this.clip.tall;
    this.sun.shadow.radius = 4;
    Object.assign(this.sun.shadow.camera, { left: -reach, right: reach, top: reach, bottom: -reach, near: 0.1 * reach, far: 6 * reach });
    scene.add(this.sun, this.sun.target);
  }

  // A grid whose lines are as wide as a pixel and fade away, and a plane that shows nothing but the shadow.
  addGround() {
    const { THREE, scene, clip } = this;
    const step = clip.tall > 3 || clip.tall < 0.3 ? 10 ** Math.round(Math.log10(clip.tall)) : 1;
    this.reach = REACH * step;
    this.grid = new THREE.Mesh(
      new THREE.PlaneGeometry(2 * REACH * step, 2 * REACH * step).rotateX(-TAU / 4),
      new THREE.ShaderMaterial({
        transparent: true, depthWrite: false,
        uniforms: { colour: { value: new THREE.Color() }, centre: { value: new THREE.Vector3() }, step: { value: step } },
        vertexShader: `varying vec3 place;
          void main() {
            vec4 world = modelMatrix * vec4(position, 1.0);
            place = world.xyz;
            gl_Position = projectionMatrix * viewMatrix * world;
          }`,
        fragmentShader: `varying vec3 place; uniform vec3 colour, centre; uniform float step;
          void main() {
            vec2 cell = place.xz / step, width = max(fwidth(cell), 1e-6);
            vec2 line = clamp(1.0 - abs(fract(cell - 0.5) - 0.5) / width, 0.0, 1.0) * min(vec2(1.0), 0.3 / width);
            float fade = clamp(1.0 - length(place.xz - centre.xz) / (${REACH}.0 * step), 0.0, 1.0);
            gl_FragColor = vec4(colour, max(line.x, line.y) * fade);
          }`,
      }),
    );
    const width = 2.6 * SHADOWED * clip.tall;
    this.ground = new THREE.Mesh(
      new THREE.PlaneGeometry(width, width).rotateX(-TAU / 4),
      new THREE.ShadowMaterial({ depthWrite: false }),
    );
    this.ground.receiveShadow = true;
    this.grid.renderOrder = 0;
    this.ground.renderOrder = 1;
    scene.add(this.grid, this.ground);
  }

  // The way of the camera's target, as a ribbon on the ground; its past is darker than its future.
  addPath() {
    const { THREE, clip, scene } = this, every = Math.max(1, Math.round(clip.fps / 10)), half = 0.008 * clip.tall;
    const frames = [];
    for (let frame = 0; frame < clip.frames; frame += every) frames.push(frame);
    const corners = new Float32Array(6 * frames.length);
    let [nx, nz] = [half, 0];
    frames.forEach((frame, i) => {
      const before = 3 * frames[Math.max(0, i - 1)], after = 3 * frames[Math.min(frames.length - 1, i + 1)];
      const dx = clip.focus[after] - clip.focus[before], dz = clip.focus[after + 2] - clip.focus[before + 2];
      const length = Math.hypot(dx, dz), x = clip.focus[3 * frame], z = clip.focus[3 * frame + 2];
      if (length > 0.1 * half) [nx, nz] = [(-dz / length) * half, (dx / length) * half];
      corners.set([x - nx, 0, z - nz, x + nx, 0, z + nz], 6 * i);
    });
    const faces = frames.slice(1).flatMap((_, i) => [2 * i, 2 * i + 1, 2 * i + 3, 2 * i, 2 * i + 3, 2 * i + 2]);
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(corners, 3));
    geometry.setIndex(faces);
    const material = (opacity) =>
      new THREE.MeshBasicMaterial({ transparent: true, depthWrite: false, side: THREE.DoubleSide, opacity });
    this.path = new THREE.Mesh(geometry, [material(0.55), material(0.18)]);
    this.path.renderOrder = 2;
    this.path.frustumCulled = false;
    this.pathEvery = every;
    scene.add(this.path);
  }

  addBody({ geometry, inverses }) {
    const { THREE, scene, clip } = this;
    this.bones = clip.parents.map(() => new THREE.Bone());
    clip.parents.forEach((parent, j) => {
      this.bones[j].position.fromArray(clip.offsets, 3 * j);
      (parent < 0 ? scene : this.bones[parent]).add(this.bones[j]);
    });
    const material = new THREE.MeshPhongMaterial({ vertexColors: true, shininess: 18, specular: "#2a2d33" });
    const body = new THREE.SkinnedMesh(geometry, material);
    body.bind(new THREE.Skeleton(this.bones, inverses), new THREE.Matrix4());
    body.frustumCulled = false;
    body.castShadow = body.receiveShadow = true;
    scene.add(body);
  }

  recolour(colours) {
    this.grid.material.uniforms.colour.value.set(colours.grid);
    this.ground.material.color.set(colours.shadow.slice(0, 7));
    this.ground.material.opacity = 1.6 * (parseInt(colours.shadow.slice(7), 16) / 255);
    this.scene.fog.color.set(colours.panel);
    for (const material of this.path.material) material.color.set(colours.ink);
  }

  pose(time) {
    const { clip, bones } = this, frame = Math.min(time * clip.fps, clip.frames - 1);
    const before = Math.floor(frame), after = Math.min(before + 1, clip.frames - 1), share = frame - before;
    const blend = (array, axis) => (1 - share) * array[3 * before + axis] + share * array[3 * after + axis];
    bones[0].position.set(...[0, 1, 2].map((axis) => blend(clip.root, axis)));
    const stride = 4 * bones.length, from = clip.rotations, a = stride * before, b = stride * after;
    bones.forEach((bone, j) => {
      const [w, x, y, z] = [0, 1, 2, 3].map((part) => (1 - share) * from[a + 4 * j + part] + share * from[b + 4 * j + part]);
      bone.quaternion.set(x, y, z, w).normalize();
    });
    this.target = new this.THREE.Vector3(...[0, 1, 2].map((axis) => blend(clip.focus, axis)));
    return before;
  }

  // The same camera as `Camera` in draw/scene.py.
  aim(view, width, height) {
    const { camera, target, clip } = this, yaw = view.yaw + clip.facing, away = view.distance * clip.tall;
    const flat = Math.cos(view.pitch), towards = [flat * Math.sin(yaw), Math.sin(view.pitch), flat * Math.cos(yaw)];
    camera.position.set(...towards).multiplyScalar(away).add(target);
    camera.lookAt(target);
    camera.aspect = width / height;
    camera.fov = (2 * Math.atan(height / 2 / (1.75 * Math.min(height, 1.25 * width))) * 360) / TAU;
    camera.near = 0.05 * clip.tall;
    camera.far = away + 2 * this.reach;
    Object.assign(this.scene.fog, { near: away + 0.2 * this.reach, far: away + this.reach });
    camera.updateProjectionMatrix();
  }

  // Ground, light and path follow the camera's target.
  follow(now) {
    const { clip, target, path, sun } = this, reach = SHADOWED * clip.tall;
    this.grid.position.set(target.x, 0, target.z);
    this.ground.position.set(target.x, 0, target.z);
    this.grid.material.uniforms.centre.value.copy(target);
    sun.target.position.copy(target);
    sun.position.set(0.1, 1.9, 1.15).applyAxisAngle(new this.THREE.Vector3(0, 1, 0), clip.facing).setLength(3 * reach).add(target);
    const last = Math.floor((clip.frames - 1) / this.pathEvery), here = Math.round(now / this.pathEvery);
    const reached = Math.round((TRAIL * clip.fps) / this.pathEvery);
    const past = Math.max(0, here - reached), future = Math.min(last, here + reached);
    path.geometry.clearGroups();
    path.geometry.addGroup(6 * past, 6 * (here - past), 0);
    path.geometry.addGroup(6 * here, 6 * (future - here), 1);
  }

  // Draws a moment with `sharpness` pixels per pixel shown.
  draw(time, view, colours, sharpness) {
    const { canvas, context, clip } = this, ratio = Math.min(window.devicePixelRatio || 1, SHARPEST);
    const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
    if (!width || !height) return;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const now = this.pose(time), ended = time > clip.end; // longer clips go on playing
    this.aim(view, width, height);
    this.follow(now);
    context.clearRect(0, 0, width, height);
    context.globalAlpha = ended ? 0.4 : 1;
    this.render(Math.ceil(sharpness * width), Math.ceil(sharpness * height));
    context.globalAlpha = 1;
    if (ended) this.ended(colours, ratio);
    else if (clip.phases.length === 1 && clip.phases[0].angle[now] !== null) {
      this.dial(clip.phases[0].angle[now], colours, ratio);
    }
  }

  // Draws with the shared renderer, whose canvas is as large as the largest scene, and copies the picture.
  render(width, height) {
    const { context, canvas } = this, renderer = sharedRenderer(this.THREE), whole = renderer.domElement;
    if (whole.width < width || whole.height < height) {
      renderer.setSize(Math.max(whole.width, width), Math.max(whole.height, height), false);
    }
    renderer.setViewport(0, 0, width, height);
    renderer.render(this.scene, this.camera);
    context.drawImage(whole, 0, whole.height - height, width, height, 0, 0, canvas.width, canvas.height);
  }

  ended(colours, ratio) {
    const { context, canvas } = this;
    context.font = `${12 * ratio}px system-ui, sans-serif`;
    context.textAlign = "right";
    context.textBaseline = "bottom";
    context.fillStyle = colours.muted;
    const last = (this.clip.frames - 1) / this.clip.fps;
    context.fillText(`ended at ${last.toFixed(1)} s`, canvas.width - 10 * ratio, canvas.height - 8 * ratio);
  }

  // Draws the phase as a clock hand: up is the right foot's contact, down the left foot's.
  dial(phase, colours, ratio) {
    const { context } = this;
    const r = 13 * ratio, x = this.canvas.width - r - 10 * ratio, y = r + 22 * ratio;
    context.font = `600 ${11 * ratio}px system-ui, sans-serif`;
    context.textAlign = "center";
    context.textBaseline = "middle";
    for (const [side, up] of [["right", 1], ["left", -1]]) {
      context.fillStyle = colours[side];
      context.fillText(side[0].toUpperCase(), x, y - up * (r + 8 * ratio));
    }
    context.lineWidth = 1.5 * ratio;
    context.strokeStyle = colours.grid;
    context.beginPath();
    context.arc(x, y, r, 0, TAU);
    context.stroke();
    context.strokeStyle = Math.cos(phase) > 0 ? colours.right : colours.left;
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x + r * Math.sin(phase), y - r * Math.cos(phase));
    context.stroke();
  }
}
