// Gives a WebXR session the light of a run: load it after an emulator of WebXR (or where a real one has no light
// estimation), and hand it the content of webxr.json before the session starts.
//
//     import { replayLight } from "./webxr_replay.js";
//     replayLight(await (await fetch("webxr.json")).json(), { object: "Vase" });
//
// The app asks as ever, for the feature "light-estimation", session.requestLightProbe() and
// frame.getLightEstimate(probe). Lights follow each other as in the run, by time from the first estimate on, and begin
// anew at the end.
export function replayLight(exported, { object = exported.lights[0].object, loops = true } = {}) {
  const lights = exported.lights.filter((light) => light.object === object);
  if (!lights.length) throw new Error(`webxr.json has no light of ${object}`);
  const pauses = lights.slice(1).map((light, place) => light.time_s - lights[place].time_s);
  const whole_s = lights.at(-1).time_s - lights[0].time_s + (pauses.at(-1) ?? 1);
  const estimates = lights.map((light) => {
    const main = light.mainLight ?? { direction: [0, 1, 0], color: [0, 0, 0], intensity: 0 };
    const [x, y, z] = main.direction;
    const [red, green, blue] = main.color.map((channel) => channel * main.intensity);
    return {
      sphericalHarmonicsCoefficients: Float32Array.from(light.sh),
      primaryLightDirection: new DOMPointReadOnly(x, y, z, 0),
      primaryLightIntensity: new DOMPointReadOnly(red, green, blue, 1),
    };
  });
  let began = null;
  const at = (elapsed_s) => {
    const time_s = loops ? elapsed_s % whole_s : Math.min(elapsed_s, whole_s);
    return estimates[lights.findLastIndex((light) => light.time_s - lights[0].time_s <= time_s)];
  };
  const probe = Object.assign(new EventTarget(), { probeSpace: new EventTarget(), onreflectionchange: null });
  // Neither grants what it does not know, and apps ask both before and after whether it was granted.
  const feature = "light-estimation";
  const requestSession = navigator.xr.requestSession.bind(navigator.xr);
  navigator.xr.requestSession = (mode, wanted) =>
    requestSession(mode, { ...wanted, requiredFeatures: wanted?.requiredFeatures?.filter((name) => name !== feature) ?? [] });
  const granted = Object.getOwnPropertyDescriptor(XRSession.prototype, "enabledFeatures");
  if (granted)
    Object.defineProperty(XRSession.prototype, "enabledFeatures", {
      ...granted,
      get() {
        return [...granted.get.call(this), feature];
      },
    });
  XRSession.prototype.requestLightProbe = () => Promise.resolve(probe);
  XRFrame.prototype.getLightEstimate = (asked) => {
    if (asked !== probe) return null;
    began ??= performance.now();
    return at((performance.now() - began) / 1000);
  };
}
