// Uses a viewer as a person would, in a headless Chromium: node view.mjs VIEWER.html FOLDER BROWSER
// Leaves screenshots at two sizes of screen in the folder, and says what it saw as one line of JSON.
import { mkdirSync } from "node:fs";
import { pathToFileURL } from "node:url";
import puppeteer from "puppeteer-core";

const [file, folder, browserPath] = process.argv.slice(2);
mkdirSync(folder, { recursive: true });
const browser = await puppeteer.launch({
  executablePath: browserPath,
  headless: true,
  args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"],
});
const SCREENS = { desk: { width: 1280, height: 860 }, phone: { width: 320, height: 568, hasTouch: true, isMobile: true } };
const saw = { errors: [], requests: [] };
for (const [name, viewport] of Object.entries(SCREENS)) {
  const page = await browser.newPage();
  page.on("pageerror", (error) => saw.errors.push(String(error)));
  page.on("console", (message) => ["error", "warn"].includes(message.type()) && saw.errors.push(message.text()));
  page.on("request", (request) => saw.requests.push(request.url().slice(0, 40)));
  await page.setViewport(viewport);
  await page.goto(pathToFileURL(file));
  const settled = () => page.waitForFunction("!busy && !again && objects.length", { timeout: 60_000 });
  // Draws and reads in one turn, before the browser takes the picture away.
  const drawn = () => page.evaluate(async () => {
    await draw();
    const gl = renderer.getContext();
    renderer.setRenderTarget(null);
    renderer.render(screen, flat);
    const pixels = new Uint8Array(gl.drawingBufferWidth * gl.drawingBufferHeight * 4);
    gl.readPixels(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    const size = [gl.drawingBufferWidth, gl.drawingBufferHeight];
    let text = "";
    for (let at = 0; at < pixels.length; at += 8192) text += String.fromCharCode(...pixels.subarray(at, at + 8192));
    return { size, rgba: btoa(text), frame: data.frames[at].frame, note: element("note").textContent };
  });
  await page.waitForFunction("document.getElementById('note').textContent !== 'Loading'", { timeout: 60_000 });
  await settled();
  await page.screenshot({ path: `${folder}/${name}.png` });
  // Not against innerWidth: on a phone that grows with a page that is too wide.
  saw[name] = await page.evaluate((width) => ({
    wide: document.documentElement.scrollWidth <= width,
    canvas: [element("picture").clientWidth, element("picture").clientHeight],
    methods: data.methods.map((one) => one.name),
    frames: data.frames.length,
    compared: data.frames.filter((frame) => frame.truth !== null).length,
  }), viewport.width);
  if (name === "phone") {
    await page.close();
    continue;
  }
  saw.first = (await drawn()).frame;
  await page.keyboard.press("End");
  await settled();
  saw.last = await page.evaluate("data.frames[at].frame");
  await page.evaluate(() => element("timeline").blur());
  await page.evaluate(() => go(nearestCompared()));
  await settled();
  // All live, all ground truth, and every method.
  for (const [label, to] of [["live", 2], ["truth", -1]]) {
    await page.evaluate((value) => void (wipe = value), to);
    saw[label] = await drawn();
    await page.screenshot({ path: `${folder}/${label}.png` });
  }
  await page.evaluate(() => void (wipe = 2));
  // Drawn between its pixels, what the phone has seen is not itself in the mean over one of them.
  await page.evaluate(async () => {
    const captured = await picture(data.frames[at].captured);
    captured.magFilter = THREE.NearestFilter;
    captured.needsUpdate = true;
  });
  saw.by_method = [];
  for (let place = 0; place < saw.desk.methods.length; place++) {
    await page.select("#method", String(place));
    await settled();
    saw.by_method.push(await drawn());
  }
  await page.select("#method", "0");
  await settled();
  // Nothing is filtered anew where only the line moves.
  saw.filtered = await page.evaluate(async () => {
    const filter = pmrem.fromEquirectangular;
    let n = 0;
    pmrem.fromEquirectangular = function (...given) { n++; return filter.apply(this, given); };
    await draw();
    pmrem.fromEquirectangular = filter;
    return n;
  });
  // The line is dragged to a quarter.
  const stage = await (await page.$("#stage")).boundingBox();
  await page.mouse.move(stage.x + stage.width / 2, stage.y + 20);
  await page.mouse.down();
  await page.mouse.move(stage.x + stage.width / 4, stage.y + 20, { steps: 4 });
  await page.mouse.up();
  await settled();
  saw.dragged = await page.evaluate("wipe");
  const before = await page.evaluate("at");
  await page.focus("#wipe");
  for (const key of ["ArrowRight", "ArrowRight", "ArrowUp"]) await page.keyboard.press(key);
  await settled();
  saw.keyed = [await page.evaluate("wipe"), await page.$eval("#wipe", (line) => Number(line.getAttribute("aria-valuenow")) / 100)];
  saw.kept_frame = before === await page.evaluate("at");
  await page.screenshot({ path: `${folder}/wiped.png` });
  saw.frame_ms = await page.evaluate(async () => {
    const start = performance.now();
    for (let place = 0; place < data.frames.length; place++) await go(place);
    renderer.getContext().finish();
    return (performance.now() - start) / data.frames.length;
  });
  await page.evaluate(() => go(0));
  await page.evaluate(() => document.activeElement.blur());
  await page.keyboard.press("Space");
  await page.waitForFunction("!playing && at === data.frames.length - 1", { timeout: 60_000 });
  saw.played = true;
  await page.close();
}
await browser.close();
console.log(JSON.stringify(saw));
