import * as THREE from "three";

export const version = THREE.REVISION;

export async function start(side) {
  const renderer = new THREE.WebGLRenderer();
  const target = new THREE.WebGLRenderTarget(side, side, { type: THREE.FloatType });
  const scene = new THREE.Scene();
  const camera = new THREE.OrthographicCamera(-1, 1, 1, -1, 0.1, 10);
  scene.add(new THREE.Mesh(new THREE.SphereGeometry(1, 256, 128), new THREE.MeshLambertMaterial({ color: 0xffffff })));
  const probe = new THREE.LightProbe();
  const sun = new THREE.DirectionalLight();
  scene.add(probe, sun);
  return (light, folder, view) => {
    camera.position.set(0, 0, view === "front" ? 5 : -5);
    camera.lookAt(0, 0, 0);
    probe.sh.fromArray(light.sh);
    sun.visible = light.mainLight !== null;
    if (sun.visible) {
      sun.position.set(...light.mainLight.direction);
      sun.color.setRGB(...light.mainLight.color);
      sun.intensity = light.mainLight.intensity;
    }
    renderer.setRenderTarget(target);
    renderer.render(scene, camera);
    const pixels = new Float32Array(side * side * 4);
    renderer.readRenderTargetPixels(target, 0, 0, side, side, pixels);
    return pixels;
  };
}
