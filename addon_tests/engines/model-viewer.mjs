import "/node_modules/@google/model-viewer/dist/model-viewer.min.js";
import { decoded, sphereGlb } from "./sphere.mjs";

export const version = "4.4.0";

const EXPOSURE = 0.4;

export async function start(side) {
  // It has no orthographic camera: from afar, by a narrow one.
  const far = 1 / Math.tan(Math.PI / 180 / 2);
  const viewer = document.createElement("model-viewer");
  viewer.style.cssText = `width: ${side}px; height: ${side}px`;
  const given = {
    "tone-mapping": "linear", exposure: EXPOSURE, loading: "eager", reveal: "auto", "interaction-prompt": "none",
    "shadow-intensity": 0, "min-field-of-view": "1deg", "max-field-of-view": "1deg", "field-of-view": "1deg",
    "min-camera-orbit": "-Infinity 0deg 1m", "max-camera-orbit": "Infinity 180deg 1000m", "interpolation-decay": 0,
    "camera-target": "0m 0m 0m",
  };
  for (const [name, value] of Object.entries(given)) viewer.setAttribute(name, value);
  document.body.append(viewer);
  viewer.src = URL.createObjectURL(new Blob([sphereGlb()], { type: "model/gltf-binary" }));
  await new Promise((done) => viewer.addEventListener("load", done, { once: true }));
  let shown = "";
  return async (light, folder, view) => {
    const url = folder + light.environment;
    if (url !== shown) {
      viewer.environmentImage = url;
      await new Promise((done) => viewer.addEventListener("environment-change", done, { once: true }));
      shown = url;
    }
    viewer.cameraOrbit = `${view === "front" ? 0 : 180}deg 90deg ${far}m`;
    await viewer.updateComplete;
    viewer.jumpCameraToGoal();
    await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
    const bitmap = await createImageBitmap(await viewer.toBlob());
    const canvas = new OffscreenCanvas(side, side);
    const context = canvas.getContext("2d");
    // Rows are wanted from the bottom.
    context.setTransform(1, 0, 0, -1, 0, side);
    context.drawImage(bitmap, 0, 0, side, side);
    return decoded(context.getImageData(0, 0, side, side).data, EXPOSURE);
  };
}
