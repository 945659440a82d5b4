// The viewer of a run: virtual objects in the captured pictures, lit by the light of the timeline, beside the ground truth.
// Everything is drawn in linear light, an object at a time under its own light, and encoded in a last pass.
"use strict";

const data = JSON.parse(document.getElementById("data").textContent);
const element = (id) => document.getElementById(id);
const bytes = (base64) => Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
const [WIDTH, HEIGHT] = data.size;
const SHADOW_SIDE = 1024;
// Places of a lamp's disc from which it shines for the shadow: so soft is its edge.
const N_PLACES = 8;

const inflated = async (base64) => {
  const stream = new Blob([bytes(base64)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint16Array(await new Response(stream).arrayBuffer());
};

// -------------------------------------------------------------------------------------------------------- what is drawn

function newRenderer() {
  try {
    return new THREE.WebGLRenderer({ canvas: element("picture"), antialias: false });
  } catch (error) {
    const fix = "open it in another browser, or switch on graphics acceleration in its settings";
    element("note").textContent = `This page needs WebGL 2, which this browser does not give: ${fix}.`;
    throw error;
  }
}

const renderer = newRenderer();
renderer.autoClear = false;
renderer.shadowMap.enabled = true;
renderer.shadowMap.type = THREE.PCFShadowMap;
const linear = new THREE.WebGLRenderTarget(1, 1, { type: THREE.HalfFloatType, samples: 4 });
const camera = new THREE.PerspectiveCamera();
camera.matrixAutoUpdate = false;
const flat = new THREE.OrthographicCamera(-1, 1, 1, -1, 0, 1);
const pmrem = new THREE.PMREMGenerator(renderer);

const shared = { roomDepth: { value: null }, keySpecular: { value: 1 }, over: { value: 1 } };

// A fragment behind the room's surface that the phone has measured is not drawn. A picture for glossy things lights no
// diffuse ones: these have their spherical harmonics.
function fitted(material) {
  material.onBeforeCompile = (shader) => {
    Object.assign(shader.uniforms, shared);
    const lit = THREE.ShaderChunk.lights_fragment_maps.replace("iblIrradiance += getIBLIrradiance( geometryNormal );", "");
    shader.fragmentShader = `uniform sampler2D roomDepth; uniform float over; uniform float keySpecular; varying float ownDepth;
      ${shader.fragmentShader}`
      .replace("void main() {", `void main() {
        float room = texture2D(roomDepth, gl_FragCoord.xy / (vec2(textureSize(roomDepth, 0)) * over)).r;
        if (room > 0.0 && ownDepth > room * 1.01 + 0.01) discard;`)
      .replace("#include <lights_fragment_maps>", lit)
      .replace("reflectedLight.directSpecular +", "reflectedLight.directSpecular * keySpecular +");
    shader.vertexShader = `varying float ownDepth;\n${shader.vertexShader}`.replace(
      "#include <project_vertex>", "#include <project_vertex>\n  ownDepth = -mvPosition.z;");
  };
  return material;
}

// What the phone has seen, as bright as lights and ground truth are: a phone exposes anew.
const behind = new THREE.ShaderMaterial({
  uniforms: { captured: { value: null }, gain: { value: new THREE.Vector3(1, 1, 1) } },
  vertexShader: "varying vec2 at; void main() { at = uv; gl_Position = vec4(position.xy, 0.0, 1.0); }",
  fragmentShader: `varying vec2 at; uniform sampler2D captured; uniform vec3 gain;
    void main() {
      vec3 c = texture2D(captured, at).rgb;
      gl_FragColor = vec4(mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c)) / gain, 1.0);
    }`,
  depthTest: false, depthWrite: false,
});
const encode = new THREE.ShaderMaterial({
  uniforms: { lit: { value: null }, truth: { value: null }, wipe: { value: 1 } },
  vertexShader: "varying vec2 at; void main() { at = uv; gl_Position = vec4(position.xy, 0.0, 1.0); }",
  fragmentShader: `varying vec2 at; uniform sampler2D lit; uniform sampler2D truth; uniform float wipe;
    void main() {
      vec3 c = clamp(texture2D(lit, at).rgb, 0.0, 1.0);
      c = mix(c * 12.92, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c));
      gl_FragColor = vec4(at.x > wipe ? texture2D(truth, at).rgb : c, 1.0);
    }`,
  depthTest: false, depthWrite: false,
});
const page = (material) => {
  const scene = new THREE.Scene();
  const quad = new THREE.Mesh(new THREE.PlaneGeometry(2, 2), material);
  quad.frustumCulled = false;
  scene.add(quad);
  return scene;
};
const [background, screen] = [page(behind), page(encode)];

const scene = new THREE.Scene();
const probe = new THREE.LightProbe();
const sun = new THREE.DirectionalLight();
sun.castShadow = true;
sun.shadow.mapSize.set(SHADOW_SIDE, SHADOW_SIDE);
sun.shadow.radius = 3;
sun.shadow.bias = -0.0005;
sun.shadow.normalBias = 0.01;
scene.add(probe, sun, sun.target);
// What the phone has seen shines through glass: it is drawn where three.js gathers what is behind that, and nowhere else.
const through = new THREE.Mesh(new THREE.PlaneGeometry(2, 2), behind.clone());
through.material.uniforms = behind.uniforms;
through.frustumCulled = false;
through.renderOrder = -1;
through.onBeforeRender = () => (through.material.colorWrite = renderer.getRenderTarget() !== linear);
scene.add(through);
const objects = [];

// ------------------------------------------------------------------------------------------------------- what is loaded

async function textureOf(uri) {
  const image = new Image();
  image.src = uri;
  await image.decode();
  const texture = new THREE.Texture(image);
  texture.colorSpace = THREE.NoColorSpace;
  texture.minFilter = texture.magFilter = THREE.LinearFilter;
  texture.generateMipmaps = false;
  texture.needsUpdate = true;
  return texture;
}

// Keeps the `most` last used of what costs memory, as a walk may have hundreds of pictures. One redraw may use no more of them.
function kept(make, most) {
  const made = new Map();
  return (key) => {
    const found = made.get(key) ?? make(key);
    made.delete(key);
    made.set(key, found);
    if (made.size > most) {
      const [oldest, old] = made.entries().next().value;
      made.delete(oldest);
      old.then((one) => one.dispose());
    }
    return found;
  };
}

const picture = kept((place) => textureOf(data.pictures[place]), 40);

const depth = kept(async (place) => {
  const millimetres = await inflated(data.depths[place]);
  const metres = Float32Array.from(millimetres, (one) => one / 1000);
  const texture = new THREE.DataTexture(metres, WIDTH, HEIGHT, THREE.RedFormat, THREE.FloatType);
  texture.minFilter = texture.magFilter = THREE.NearestFilter;
  texture.flipY = true;
  texture.needsUpdate = true;
  return texture;
}, 8);

const MOST_LIGHTS = 24 + 3 * data.objects.length;
const reflected = kept(
  async (place) => surroundings(new THREE.HDRLoader().parse(bytes(data.reflections[place]).buffer)), MOST_LIGHTS);

// What glossy things see where the phone's pictures are not asked for: the radiance of the coefficients.
const radiance = kept(async (key) => {
  const sh = JSON.parse(key);
  const [width, height] = [64, 32];
  const values = new Float32Array(width * height * 4);
  for (let row = 0; row < height; row++)
    for (let column = 0; column < width; column++) {
      const polar = (Math.PI * (row + 0.5)) / height;
      const azimuth = 2 * Math.PI * ((column + 0.5) / width - 0.5);
      const [x, y, z] = [Math.sin(polar) * Math.cos(azimuth), Math.cos(polar), Math.sin(polar) * Math.sin(azimuth)];
      const basis = [0.282095, 0.488603 * y, 0.488603 * z, 0.488603 * x, 1.092548 * x * y, 1.092548 * y * z,
        0.315392 * (3 * z * z - 1), 1.092548 * x * z, 0.546274 * (x * x - y * y)];
      for (let c = 0; c < 3; c++)
        values[(row * width + column) * 4 + c] = Math.max(0, basis.reduce((sum, b, i) => sum + b * sh[3 * i + c], 0));
    }
  return surroundings({ data: values, width, height, type: THREE.FloatType });
}, MOST_LIGHTS);

function surroundings(panorama) {
  const texture = new THREE.DataTexture(panorama.data, panorama.width, panorama.height, THREE.RGBAFormat, panorama.type);
  texture.mapping = THREE.EquirectangularReflectionMapping;
  texture.minFilter = texture.magFilter = THREE.LinearFilter;
  // Rows of the file begin at the top.
  texture.flipY = true;
  texture.needsUpdate = true;
  const made = pmrem.fromEquirectangular(texture);
  texture.dispose();
  return made;
}

async function loadObjects() {
  const loader = new THREE.GLTFLoader();
  for (const one of data.objects) {
    const root = (await loader.parseAsync(bytes(one.glb).buffer, "")).scene;
    root.matrixAutoUpdate = false;
    const materials = new Set();
    root.traverse((mesh) => {
      if (!mesh.isMesh) return;
      mesh.castShadow = true;
      for (const material of [mesh.material].flat()) materials.add(fitted(material));
    });
    // Lights carry the exposure; what shines by itself does not yet.
    for (const material of materials) material.emissiveIntensity *= data.exposure;
    // A surface takes from the picture what the key light brings to it, where the object is in its way.
    const floor = new THREE.ShadowMaterial({ depthWrite: false });
    scene.add(root);
    objects.push({ ...one, root, floor: fitted(floor), surfaces: [] });
  }
}

// ------------------------------------------------------------------------------------------------------------- a picture

const STEP = 0.02; // Of the line, by one arrow key
let [at, method, wipe, playing, busy, again] = [0, 0, 0.5, false, false, false];

const lightAt = (lights, frame) => lights.findLast((light) => light.frame <= frame) ?? null;

function placed(one, frame) {
  const place = one.matrices.length === 1 ? 0 : data.frames.indexOf(frame);
  one.root.matrix.fromArray(one.matrices[place]);
  one.root.matrixWorldNeedsUpdate = true;
}

function surfacesOf(one, frame) {
  for (const mesh of one.surfaces.splice(0)) {
    scene.remove(mesh);
    mesh.geometry.dispose();
  }
  for (const outline of frame.surfaces[one.name] ?? []) {
    const geometry = new THREE.BufferGeometry();
    const corners = outline.corners;
    const fan = corners.slice(2).flatMap((corner, i) => [corners[0], corners[i + 1], corner]).flat();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(fan, 3));
    const normals = Array.from({ length: fan.length / 3 }, () => outline.normal).flat();
    geometry.setAttribute("normal", new THREE.Float32BufferAttribute(normals, 3));
    const material = one.floor.clone();
    fitted(material);
    material.side = 2;
    const mesh = new THREE.Mesh(geometry, material);
    mesh.receiveShadow = true;
    mesh.userData.normal = outline.normal;
    one.surfaces.push(mesh);
    scene.add(mesh);
  }
}

// The share of a surface's light that is the key light's: it is missing in the shadow.
function shareOfKey(light, normal) {
  const main = light.mainLight;
  const facing = Math.max(0, main.direction.reduce((sum, c, i) => sum + c * normal[i], 0));
  const key = main.intensity * facing * (0.2126 * main.color[0] + 0.7152 * main.color[1] + 0.0722 * main.color[2]);
  const [x, y, z] = normal;
  const weights = [0.886227, 1.023328 * y, 1.023328 * z, 1.023328 * x, 0.858086 * x * y, 0.858086 * y * z,
    0.743125 * z * z - 0.247708, 0.858086 * x * z, 0.429043 * (x * x - y * y)];
  const luminance = (i) => 0.2126 * light.sh[3 * i] + 0.7152 * light.sh[3 * i + 1] + 0.0722 * light.sh[3 * i + 2];
  const rest = Math.max(0, weights.reduce((sum, w, i) => sum + w * luminance(i), 0));
  return key > 0 ? key / (key + rest) : 0;
}

// The middle of the lamp, or the n-th place of its disc.
function setSun(light, one, place = -1) {
  sun.visible = light.mainLight !== null;
  if (!sun.visible) return;
  const middle = new THREE.Vector3().fromArray(one.middle).applyMatrix4(one.root.matrix);
  const towards = new THREE.Vector3().fromArray(light.mainLight.direction);
  if (place >= 0) {
    const across = new THREE.Vector3(1, 0, 0);
    if (Math.abs(towards.x) > 0.7) across.set(0, 1, 0);
    const right = across.cross(towards).normalize();
    const up = new THREE.Vector3().crossVectors(towards, right);
    const out = Math.tan(Math.min(light.mainLight.angularRadius, 1)) * Math.sqrt((place + 0.5) / N_PLACES);
    const turn = place * Math.PI * (3 - Math.sqrt(5));
    towards.addScaledVector(right, out * Math.cos(turn)).addScaledVector(up, out * Math.sin(turn)).normalize();
  }
  sun.color.setRGB(...light.mainLight.color);
  sun.intensity = light.mainLight.intensity;
  const reach = Math.max(0.05, one.radius * 3);
  sun.target.position.copy(middle);
  sun.target.updateMatrixWorld();
  sun.position.copy(middle).addScaledVector(towards, reach * 4);
  const box = sun.shadow.camera;
  [box.left, box.right, box.bottom, box.top, box.near, box.far] = [-reach, reach, -reach, reach, reach * 0.1, reach * 12];
  box.updateProjectionMatrix();
}

function setCamera(frame) {
  camera.matrix.fromArray(frame.camera.matrix);
  camera.matrixWorld.copy(camera.matrix);
  camera.matrixWorldInverse.copy(camera.matrix).invert();
  const { fx, fy, cx, cy } = frame.camera;
  const [near, far] = [0.01, 200];
  camera.projectionMatrix.set(
    (2 * fx) / WIDTH, 0, 1 - (2 * cx) / WIDTH, 0,
    0, (2 * fy) / HEIGHT, (2 * cy) / HEIGHT - 1, 0,
    0, 0, -(far + near) / (far - near), (-2 * far * near) / (far - near),
    0, 0, -1, 0);
  camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
}

async function draw() {
  if (busy) return void (again = true);
  busy = true;
  do {
    again = false;
    const frame = data.frames[at];
    const lights = data.methods[method].lights;
    behind.uniforms.captured.value = await picture(frame.captured);
    shared.roomDepth.value = await depth(frame.depth);
    const truth = frame.truth === null ? null : await picture(frame.truth);
    const all = [];
    for (const one of objects) {
      const light = lightAt(lights[one.name] ?? [], frame.frame);
      const own = light && (light.reflections === null ? await radiance(JSON.stringify(light.sh)) : await reflected(light.reflections));
      all.push([one, light, own]);
    }
    setCamera(frame);
    behind.uniforms.gain.value.fromArray(frame.gain);
    renderer.setRenderTarget(linear);
    renderer.clear();
    renderer.render(background, flat);
    for (const [one] of all) placed(one, frame);
    // Shadows first, on the room; then the objects, which hide them.
    for (const part of ["shadows", "objects"])
      for (const [one, light, own] of all) {
        if (light === null) continue;
        if (part === "shadows") surfacesOf(one, frame);
        setSun(light, one);
        if (part === "shadows" && !(sun.visible && one.surfaces.length)) continue;
        probe.sh.fromArray(light.sh);
        shared.keySpecular.value = light.hasLamp ? 0 : 1;
        for (const [other] of all) {
          other.root.visible = other === one;
          for (const mesh of other.surfaces) mesh.visible = part === "shadows" && other === one && sun.visible;
        }
        // All places together take away the whole share.
        for (const mesh of one.surfaces)
          if (sun.visible) mesh.material.opacity = 1 - (1 - shareOfKey(light, mesh.userData.normal)) ** (1 / N_PLACES);
        one.root.traverse((mesh) => {
          if (!mesh.isMesh) return;
          for (const material of [mesh.material].flat()) {
            material.envMap = own.texture;
            // The object throws its shadow without being seen itself.
            material.colorWrite = material.depthWrite = part === "objects";
          }
        });
        for (let place = 0; place < (part === "shadows" ? N_PLACES : 1); place++) {
          if (part === "shadows") setSun(light, one, place);
          renderer.render(scene, camera);
        }
      }
    const isWiped = element("compare").checked && truth !== null;
    Object.assign(encode.uniforms.lit, { value: linear.texture });
    Object.assign(encode.uniforms.truth, { value: truth ?? behind.uniforms.captured.value });
    encode.uniforms.wipe.value = isWiped ? wipe : 2;
    renderer.setRenderTarget(null);
    renderer.render(screen, flat);
    told(frame, isWiped, all.every(([, light]) => light === null));
  } while (again);
  busy = false;
}

// --------------------------------------------------------------------------------------------------------------- the page

function told(frame, isWiped, isDark) {
  element("timeline").value = at;
  element("frame").textContent = `frame ${frame.frame}, ${frame.time_s.toFixed(2)} s`;
  element("wipe").hidden = !isWiped;
  element("wipe").style.left = `${100 * wipe}%`;
  element("wipe").setAttribute("aria-valuenow", Math.round(100 * wipe));
  element("left").textContent = data.methods[method].title;
  element("right").textContent = isWiped ? "ground truth" : "";
  const lacks = element("compare").checked && frame.truth === null;
  const nearest = lacks ? nearestCompared() : null;
  element("note").textContent = isDark
    ? "No light is known yet in this frame."
    : lacks && nearest !== null ? `No ground truth in this frame; the nearest is in frame ${data.frames[nearest].frame}.` : "";
  element("numbers").replaceChildren(
    ...[...frame.numbers, ...(frame.by_method[data.methods[method].name] ?? [])].map(([name, value]) => {
      const row = document.createElement("div");
      const [term, told] = [document.createElement("dt"), document.createElement("dd")];
      [term.textContent, told.textContent] = [name, value];
      row.append(term, told);
      return row;
    }));
}

function nearestCompared() {
  const compared = data.frames.map((frame, place) => (frame.truth === null ? -1 : place)).filter((place) => place >= 0);
  if (!compared.length) return null;
  return compared.reduce((best, place) => (Math.abs(place - at) < Math.abs(best - at) ? place : best));
}

function go(to) {
  at = Math.max(0, Math.min(data.frames.length - 1, to));
  return draw();
}

function fit() {
  const stage = element("stage");
  stage.style.aspectRatio = `${WIDTH} / ${HEIGHT}`;
  stage.style.maxWidth = `${(window.innerHeight * 0.68 * WIDTH) / HEIGHT}px`;
  const wide = stage.clientWidth * Math.min(2, window.devicePixelRatio);
  // A whole number of pixels over each of the depth's, so that both end at the same places.
  const over = Math.max(1, Math.min(6, Math.round(wide / WIDTH)));
  shared.over.value = over;
  renderer.setSize(WIDTH * over, HEIGHT * over, false);
  linear.setSize(WIDTH * over, HEIGHT * over);
  draw();
}

let began = 0;
let from = 0;

async function played(now) {
  if (!playing) return;
  const elapsed_s = (now - began) / 1000;
  const start_s = data.frames[from].time_s;
  const to = data.frames.findLastIndex((frame) => frame.time_s - start_s <= elapsed_s);
  if (to !== at) await go(to);
  if (to === data.frames.length - 1) return toggle();
  requestAnimationFrame(played);
}

function toggle() {
  playing = !playing;
  element("play").textContent = playing ? "Pause" : "Play";
  element("play").setAttribute("aria-label", element("play").textContent);
  if (!playing) return;
  from = at === data.frames.length - 1 ? 0 : at;
  began = performance.now();
  go(from).then(() => requestAnimationFrame(played));
}

function dragged(event) {
  const box = element("stage").getBoundingClientRect();
  wipeTo((event.clientX - box.left) / box.width);
}

function wipeTo(share) {
  wipe = Math.max(0, Math.min(1, share));
  draw();
}

function listen() {
  element("timeline").max = data.frames.length - 1;
  element("timeline").addEventListener("input", () => go(Number(element("timeline").value)));
  element("play").addEventListener("click", toggle);
  for (const [place, one] of data.methods.entries()) element("method").add(new Option(one.title, place));
  element("method").addEventListener("change", () => draw((method = Number(element("method").value))));
  element("compare").addEventListener("change", () => {
    const nearest = nearestCompared();
    // Who asks for the ground truth wants to see one.
    if (element("compare").checked && nearest !== null) go(nearest);
    else draw();
  });
  const stage = element("stage");
  stage.addEventListener("pointerdown", (event) => {
    if (!element("compare").checked) return;
    stage.setPointerCapture(event.pointerId);
    dragged(event);
  });
  stage.addEventListener("pointermove", (event) => stage.hasPointerCapture(event.pointerId) && dragged(event));
  // Who has dragged the line steps through frames with the arrow keys; who has tabbed to it moves it.
  stage.addEventListener("pointerup", () => element("wipe").blur());
  window.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey) return; // The browser's own, such as Alt and an arrow: back.
    const isTyping = ["SELECT", "INPUT"].includes(event.target.tagName) && event.target.id !== "compare";
    const isPressed = event.key === " " && (event.target.tagName === "BUTTON" || event.target.id === "compare");
    const key = event.key === "W" ? "w" : event.key;
    const [less, more] = [wipe - STEP, wipe + STEP];
    const moves = { ArrowLeft: less, ArrowDown: less, ArrowRight: more, ArrowUp: more, Home: 0, End: 1 };
    if (event.target.id === "wipe" && key in moves) {
      event.preventDefault();
      wipeTo(moves[key]);
      return;
    }
    const actions = {
      " ": toggle,
      ArrowRight: () => go(at + 1),
      ArrowLeft: () => go(at - 1),
      Home: () => go(0),
      End: () => go(data.frames.length - 1),
      w: () => element("compare").click(),
    };
    const action = actions[key];
    if (!action || (isTyping && key !== "w") || isPressed) return;
    event.preventDefault();
    action();
  });
  window.addEventListener("resize", fit);
}

loadObjects().then(() => {
  element("note").textContent = "";
  listen();
  fit();
  element("compare").disabled = nearestCompared() === null;
  if (nearestCompared() !== null) {
    element("compare").checked = true;
    at = nearestCompared();
  }
  return draw();
}).catch((error) => {
  element("note").textContent = `This browser could not show it: ${error.message}`;
});
