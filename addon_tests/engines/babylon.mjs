import { Constants } from "@babylonjs/core/Engines/constants.js";
import { Engine } from "@babylonjs/core/Engines/engine.js";
import { Camera } from "@babylonjs/core/Cameras/camera.js";
import { FreeCamera } from "@babylonjs/core/Cameras/freeCamera.js";
import { Color3 } from "@babylonjs/core/Maths/math.color.js";
import { Vector3 } from "@babylonjs/core/Maths/math.vector.js";
import { SphericalHarmonics, SphericalPolynomial } from "@babylonjs/core/Maths/sphericalPolynomial.js";
import { DirectionalLight } from "@babylonjs/core/Lights/directionalLight.js";
import { PBRMaterial } from "@babylonjs/core/Materials/PBR/pbrMaterial.js";
import { RawCubeTexture } from "@babylonjs/core/Materials/Textures/rawCubeTexture.js";
import { RenderTargetTexture } from "@babylonjs/core/Materials/Textures/renderTargetTexture.js";
import { CreateSphere } from "@babylonjs/core/Meshes/Builders/sphereBuilder.js";
import { Scene } from "@babylonjs/core/scene.js";
import "@babylonjs/core/Materials/Textures/baseTexture.polynomial.js";

export const version = Engine.Version;

export async function start(side) {
  const canvas = document.body.appendChild(document.createElement("canvas"));
  canvas.width = canvas.height = side;
  const engine = new Engine(canvas, false);
  const scene = new Scene(engine);
  const camera = new FreeCamera("camera", new Vector3(0, 0, 5), scene);
  camera.mode = Camera.ORTHOGRAPHIC_CAMERA;
  [camera.orthoLeft, camera.orthoRight, camera.orthoBottom, camera.orthoTop] = [-1, 1, -1, 1];
  const sphere = CreateSphere("sphere", { diameter: 2, segments: 128 }, scene);
  const white = new PBRMaterial("white", scene);
  [white.metallic, white.roughness] = [0, 1];
  // No highlight: the sphere is compared with a matt one.
  white.metallicF0Factor = 0;
  // Its own default bends light towards the view as rough surfaces do; Cycles here has a Lambert surface.
  white.brdf.baseDiffuseModel = Constants.MATERIAL_DIFFUSE_MODEL_LAMBERT;
  sphere.material = white;
  const black = new Array(6).fill(new Uint8Array(4));
  scene.environmentTexture = new RawCubeTexture(scene, black, 1);
  scene.imageProcessingConfiguration.applyByPostProcess = true;
  const target = new RenderTargetTexture("target", side, scene, { type: Engine.TEXTURETYPE_FLOAT, generateMipMaps: false });
  target.activeCamera = camera;
  target.renderList = [sphere];
  const sun = new DirectionalLight("sun", new Vector3(0, -1, 0), scene);
  return async (light, folder, view) => {
    camera.position.z = view === "front" ? 5 : -5;
    camera.setTarget(Vector3.Zero());
    const nine = Array.from({ length: 9 }, (_, i) => light.sh.slice(3 * i, 3 * i + 3));
    const harmonics = SphericalHarmonics.FromArray(nine);
    harmonics.convertIncidentRadianceToIrradiance();
    harmonics.convertIrradianceToLambertianRadiance();
    scene.environmentTexture.sphericalPolynomial = SphericalPolynomial.FromHarmonics(harmonics);
    sun.setEnabled(light.mainLight !== null);
    if (light.mainLight !== null) {
      sun.direction = new Vector3(...light.mainLight.direction);
      sun.diffuse = new Color3(...light.mainLight.color);
      sun.intensity = light.mainLight.intensity;
    }
    await scene.whenReadyAsync();
    while (!target.isReadyForRendering()) await new Promise((done) => setTimeout(done, 20));
    target.render();
    return target.readPixels();
  };
}
