import * as pc from "playcanvas";

export const version = pc.version;

export async function start(side) {
  const canvas = document.body.appendChild(document.createElement("canvas"));
  canvas.width = canvas.height = side;
  const device = await pc.createGraphicsDevice(canvas, { deviceTypes: [pc.DEVICETYPE_WEBGL2] });
  const options = new pc.AppOptions();
  options.graphicsDevice = device;
  options.componentSystems = [pc.RenderComponentSystem, pc.CameraComponentSystem, pc.LightComponentSystem];
  options.resourceHandlers = [pc.TextureHandler];
  const app = new pc.AppBase(canvas);
  app.init(options);
  const colour = new pc.Texture(device, { width: side, height: side, format: pc.PIXELFORMAT_RGBA32F, mipmaps: false });
  const target = new pc.RenderTarget({ colorBuffer: colour, depth: true });
  const camera = new pc.Entity();
  camera.addComponent("camera", {
    projection: pc.PROJECTION_ORTHOGRAPHIC, orthoHeight: 1, nearClip: 0.1, farClip: 10, renderTarget: target,
    toneMapping: pc.TONEMAP_NONE, gammaCorrection: pc.GAMMA_NONE, clearColor: new pc.Color(0, 0, 0, 0),
  });
  const white = new pc.StandardMaterial();
  white.diffuse = new pc.Color(1, 1, 1);
  white.specular = new pc.Color(0, 0, 0);
  white.gloss = 0;
  white.update();
  const mesh = pc.Mesh.fromGeometry(device, new pc.SphereGeometry({ radius: 1, latitudeBands: 128, longitudeBands: 256 }));
  const sphere = new pc.Entity();
  sphere.addComponent("render", { meshInstances: [new pc.MeshInstance(mesh, white)] });
  const sun = new pc.Entity();
  sun.addComponent("light", { type: "directional", castShadows: false });
  for (const entity of [camera, sphere, sun]) app.root.addChild(entity);
  app.scene.skyboxIntensity = 1;
  app.start();
  let shown = "";
  return async (light, folder, view) => {
    const url = folder + light.environment;
    if (url !== shown) {
      const asset = new pc.Asset("light", "texture", { url, filename: "light.hdr" }, { mipmaps: false });
      app.assets.add(asset);
      await new Promise((done, failed) => {
        asset.ready(done);
        asset.on("error", failed);
        app.assets.load(asset);
      });
      const source = pc.EnvLighting.generateLightingSource(asset.resource);
      app.scene.envAtlas = pc.EnvLighting.generateAtlas(source);
      shown = url;
    }
    camera.setPosition(0, 0, view === "front" ? 5 : -5);
    camera.lookAt(0, 0, 0);
    sun.enabled = light.mainLight !== null;
    if (sun.enabled) {
      sun.light.color = new pc.Color(...light.mainLight.color);
      sun.light.intensity = light.mainLight.intensity;
      // A light shines along its -Y.
      const travel = new pc.Vec3(...light.mainLight.direction);
      const down = new pc.Vec3(0, -1, 0);
      const axis = new pc.Vec3().cross(down, travel);
      const turned = new pc.Quat(axis.x, axis.y, axis.z, 1 + down.dot(travel)).normalize();
      sun.setRotation(turned);
    }
    // A light that has moved shines from its new place in the second frame.
    app.render();
    app.render();
    const pixels = new Float32Array(side * side * 4);
    const gl = device.gl;
    device.setFramebuffer(target.impl._glFrameBuffer);
    gl.readPixels(0, 0, side, side, gl.RGBA, gl.FLOAT, pixels);
    device.setFramebuffer(null);
    return pixels;
  };
}
