// Unpacks what Python packed: the renderer, bodies, motion. Everything is compressed text inside the page.

async function inflate(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// The opposite of `pack`: four planes of bytes, signs in the lowest bit, differences from row to row; by columns.
async function unpack(text, columns, unit = 1) {
  const bytes = await inflate(text), count = bytes.length / 4, rows = count / columns;
  const values = new Float32Array(count);
  for (let column = 0; column < columns; column++) {
    let value = 0;
    for (let row = 0, i = column * rows; row < rows; row++, i++) {
      const coded = bytes[i] + 256 * (bytes[i + count] + 256 * (bytes[i + 2 * count] + 256 * bytes[i + 3 * count]));
      value += coded % 2 ? -(coded + 1) / 2 : coded / 2;
      values[row * columns + column] = value * unit;
    }
  }
  return values;
}

// Runs the renderer in a function of its own, so that it neither meets nor leaves names in the page.
let renderer; // a promise of three.js, once for all players of a page
function loadRenderer() {
  renderer ??= inflate(document.querySelector("script.motion-renderer").textContent).then((bytes) => {
    const script = document.createElement("script");
    script.textContent = `((exports, module) => {${new TextDecoder().decode(bytes)}\n})(globalThis.motionRenderer = {}, {});`;
    document.head.append(script);
    script.remove();
    const loaded = globalThis.motionRenderer;
    delete globalThis.motionRenderer;
    return loaded;
  });
  return renderer;
}

async function loadMesh(THREE, data) {
  const { joints, unit } = data, geometry = new THREE.BufferGeometry();
  const [vertices, normals, faces, bones, weights, colours, bind] = await Promise.all([
    unpack(data.vertices, 3, unit), unpack(data.normals, 3, 1 / 127), unpack(data.faces, 3),
    unpack(data.bones, 4), unpack(data.weights, 4, 1 / 255), unpack(data.colours, 3, 1 / 255), unpack(data.bind, 7),
  ]);
  const linear = (c) => (c < 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
  geometry.setAttribute("position", new THREE.BufferAttribute(vertices, 3));
  geometry.setAttribute("normal", new THREE.BufferAttribute(normals, 3));
  geometry.setAttribute("color", new THREE.BufferAttribute(colours.map(linear), 3));
  geometry.setAttribute("skinIndex", new THREE.BufferAttribute(new Uint16Array(bones), 4));
  geometry.setAttribute("skinWeight", new THREE.BufferAttribute(weights, 4));
  geometry.setIndex(new THREE.BufferAttribute(new Uint32Array(faces), 1));
  const inverses = Array.from({ length: joints }, (_, j) => {
    const [x, y, z, qw, qx, qy, qz] = bind.subarray(7 * j, 7 * j + 7);
    const rotation = new THREE.Quaternion(qx, qy, qz, qw).normalize(), one = new THREE.Vector3(1, 1, 1);
    return new THREE.Matrix4().compose(new THREE.Vector3(x, y, z).multiplyScalar(unit), rotation, one).invert();
  });
  return { geometry, inverses };
}

async function loadClip(clip) {
  const count = clip.parents.length, { unit } = clip;
  const [offsets, root, rotations, focus] = await Promise.all([
    unpack(clip.offsets, 3, unit), unpack(clip.root, 3, unit), unpack(clip.rotations, 4 * count),
    unpack(clip.focus, 3, unit),
  ]);
  return { ...clip, offsets, root, rotations, focus, frames: focus.length / 3 };
}
