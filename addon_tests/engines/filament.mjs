import { decoded, sphereGlb } from "./sphere.mjs";

export const version = "1.53.4";

const EXPOSURE = 0.4;

export async function start(side) {
  await new Promise((done, failed) => {
    const script = document.createElement("script");
    [script.src, script.onload, script.onerror] = ["/node_modules/filament/filament.js", done, failed];
    document.head.append(script);
  });
  await new Promise((done) => Filament.init([], done));
  const canvas = document.body.appendChild(document.createElement("canvas"));
  canvas.width = canvas.height = side;
  const engine = Filament.Engine.create(canvas);
  const gl = canvas.getContext("webgl2");
  const [scene, swapChain, renderer, view] = [engine.createScene(), engine.createSwapChain(), engine.createRenderer(), engine.createView()];
  const camera = engine.createCamera(Filament.EntityManager.get().create());
  camera.setProjection(Filament.Camera$Projection.ORTHO, -1, 1, -1, 1, 0.1, 10);
  // What it takes is the radiance that becomes white.
  camera.setExposureDirect(1 / EXPOSURE);
  view.setCamera(camera);
  view.setScene(scene);
  view.setViewport([0, 0, side, side]);
  view.setAntiAliasing(Filament.View$AntiAliasing.NONE);
  const grading = Filament.ColorGrading.Builder().toneMapping(Filament.ColorGrading$ToneMapping.LINEAR).build(engine);
  view.setColorGrading(grading);
  const asset = engine.createAssetLoader().createAsset(sphereGlb());
  await new Promise((done) => asset.loadResources(done, () => {}, "", 1));
  scene.addEntities(asset.getEntities());
  const sun = Filament.EntityManager.get().create();
  return (light, folder, from) => {
    camera.lookAt([0, 0, from === "front" ? 5 : -5], [0, 0, 0], [0, 1, 0]);
    const soft = Filament.IndirectLight.Builder().irradianceSh(3, light.sh).intensity(1).build(engine);
    scene.setIndirectLight(soft);
    scene.remove(sun);
    engine.getLightManager?.().destroy?.(sun);
    if (light.mainLight !== null) {
      Filament.LightManager.Builder(Filament.LightManager$Type.DIRECTIONAL)
        .color(light.mainLight.color)
        .intensity(light.mainLight.intensity)
        .direction(light.mainLight.direction)
        .castShadows(false)
        .build(engine, sun);
      scene.addEntity(sun);
    }
    renderer.render(swapChain, view);
    renderer.render(swapChain, view);
    const pixels = new Uint8Array(side * side * 4);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, null);
    gl.readPixels(0, 0, side, side, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    return decoded(pixels, EXPOSURE);
  };
}
