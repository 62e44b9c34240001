// Opens GLB files as an application with three.js does: GLTFLoader, AnimationMixer, WebGLRenderer.
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';

// Returns the file and a function that sets its clip of this name to a time.
async function open(url, name) {
  const gltf = await new GLTFLoader().loadAsync(url);
  const mixer = new THREE.AnimationMixer(gltf.scene);
  const clip = gltf.animations.find((each) => each.name === name);
  const setTime = (seconds) => {
    if (clip) mixer.setTime(seconds);
    gltf.scene.updateMatrixWorld(true);
  };
  if (clip) {
    const action = mixer.clipAction(clip);
    action.setLoop(THREE.LoopOnce);
    action.clampWhenFinished = true;
    action.play();
  }
  return { gltf, setTime };
}

// Returns world positions [times][numbers][3] of nodes, the height of the lowest vertex at each time if `lowest`, and
// names and durations of the clips.
window.sample = async (url, name, times, numbers, vertices) => {
  const { gltf, setTime } = await open(url, name);
  const nodes = await Promise.all(numbers.map((number) => gltf.parser.getDependency('node', number)));
  const positions = [], lowest = [];
  for (const time of times) {
    setTime(time);
    positions.push(nodes.map((node) => node.getWorldPosition(new THREE.Vector3()).toArray()));
    if (vertices) lowest.push(new THREE.Box3().setFromObject(gltf.scene, true).min.y);
  }
  return { positions, lowest, clips: gltf.animations.map((each) => [each.name, each.duration]) };
};

// Draws the file at each of some times on one strip, seen from `azimuth` degrees to the left of +Z, and returns nothing.
// A picture has size [width, height]; the camera follows the body with `reach` times its height in view.
window.draw = async (url, name, times, [width, height], azimuth = 35, reach = 1.25) => {
  const { gltf, setTime } = await open(url, name);
  const canvas = document.getElementById('canvas');
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true });
  renderer.setSize(width * times.length, height);
  renderer.setScissorTest(true);
  renderer.setClearColor(0xf2f1ee);
  const scene = new THREE.Scene();
  scene.add(new THREE.HemisphereLight(0xffffff, 0x998877, 2.2));
  const sun = new THREE.DirectionalLight(0xffffff, 2.0);
  scene.add(sun, gltf.scene);
  gltf.scene.traverse((object) => { object.frustumCulled = false; });
  setTime(times[0]);
  const first = new THREE.Box3().setFromObject(gltf.scene, true);
  const size = first.getSize(new THREE.Vector3()).y;
  const middle = first.getCenter(new THREE.Vector3()).y;
  const grid = new THREE.GridHelper(40 * size, 80, 0xbbb8b0, 0xd4d1ca);
  grid.position.y = first.min.y;
  scene.add(grid);
  const turn = THREE.MathUtils.degToRad(azimuth);
  for (const [index, time] of times.entries()) {
    setTime(time);
    const box = new THREE.Box3().setFromObject(gltf.scene, true);
    const centre = box.getCenter(new THREE.Vector3());
    centre.y = middle;
    const half = (reach * size) / 2, wide = (half * width) / height;
    const camera = new THREE.OrthographicCamera(-wide, wide, half, -half, 0.01 * size, 30 * size);
    camera.position.set(Math.sin(turn), 0.25, Math.cos(turn)).multiplyScalar(8 * size).add(centre);
    camera.lookAt(centre);
    sun.position.copy(camera.position).add(new THREE.Vector3(3 * size, 6 * size, 0));
    renderer.setViewport(index * width, 0, width, height);
    renderer.setScissor(index * width, 0, width, height);
    renderer.render(scene, camera);
  }
  renderer.dispose();
};
window.ready = true;
