// glTF files as Babylon.js reads them: light and sphere come through its loader, which turns both for its own axes.
import { Constants } from "@babylonjs/core/Engines/constants.js";
import { Engine } from "@babylonjs/core/Engines/engine.js";
import { AppendSceneAsync } from "@babylonjs/core/Loading/sceneLoader.js";
import { Camera } from "@babylonjs/core/Cameras/camera.js";
import { FreeCamera } from "@babylonjs/core/Cameras/freeCamera.js";
import { Vector3 } from "@babylonjs/core/Maths/math.vector.js";
import { PBRMaterial } from "@babylonjs/core/Materials/PBR/pbrMaterial.js";
import { RenderTargetTexture } from "@babylonjs/core/Materials/Textures/renderTargetTexture.js";
import { Scene } from "@babylonjs/core/scene.js";
import "@babylonjs/core/Loading/loadingScreen.js";
import "@babylonjs/core/Materials/Textures/baseTexture.polynomial.js";
import "@babylonjs/loaders/glTF/2.0/index.js";
import { sphereGlb } from "./sphere.mjs";

export const version = Engine.Version;

// Of a white metal, in place of the matt surface.
const ROUGHNESS = { mirror: 0, rough: 0.56, rougher: 0.85 };

export async function start(side) {
  const canvas = document.body.appendChild(document.createElement("canvas"));
  canvas.width = canvas.height = side;
  const engine = new Engine(canvas, false);
  const sphere = URL.createObjectURL(new Blob([sphereGlb()], { type: "model/gltf-binary" }));
  return async (light, folder, view) => {
    const scene = new Scene(engine);
    const file = `${folder}Sphere_${String(light.frame).padStart(4, "0")}.gltf`;
    await AppendSceneAsync(file, scene);
    await AppendSceneAsync(sphere, scene, { pluginExtension: ".glb" });
    scene.environmentTexture.gammaSpace = false;
    const roughness = ROUGHNESS[folder.split("/").at(-3)];
    const white = new PBRMaterial("white", scene);
    [white.metallic, white.roughness, white.metallicF0Factor] = roughness === undefined ? [0, 1, 0] : [1, roughness, 1];
    white.brdf.baseDiffuseModel = Constants.MATERIAL_DIFFUSE_MODEL_LAMBERT;
    // By default a part of what rough metal reflects, alpha, is the soft light along the normal.
    white.brdf.mixIblRadianceWithIrradiance = false;
    for (const mesh of scene.meshes) mesh.material = white;
    // From afar: its shader looks from where the camera stands, in an orthographic view as well.
    const camera = new FreeCamera("camera", new Vector3(0, 0, view === "front" ? 500 : -500), scene);
    camera.mode = Camera.ORTHOGRAPHIC_CAMERA;
    [camera.orthoLeft, camera.orthoRight, camera.orthoBottom, camera.orthoTop] = [-1, 1, -1, 1];
    camera.setTarget(Vector3.Zero());
    scene.imageProcessingConfiguration.applyByPostProcess = true;
    const target = new RenderTargetTexture("target", side, scene, { type: Engine.TEXTURETYPE_FLOAT, generateMipMaps: false });
    target.activeCamera = camera;
    target.renderList = scene.meshes;
    await scene.whenReadyAsync();
    while (!target.isReadyForRendering()) await new Promise((done) => setTimeout(done, 20));
    target.render();
    const pixels = await target.readPixels();
    scene.dispose();
    return pixels;
  };
}
