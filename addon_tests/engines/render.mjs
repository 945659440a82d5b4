// Draws a sphere under exported lights in real engines, in a headless Chromium: node render.mjs JOB.json
// The job names the engines, the lights (folders of exports), the picture's side, the browser, and where pictures go:
// ENGINE/LIGHT_VIEW.f32, RGB, rows from the top, linear. One line of JSON says the versions of the engines.
import { createReadStream, existsSync, mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { extname, join, normalize } from "node:path";
import puppeteer from "puppeteer-core";

const HERE = import.meta.dirname;
const TYPES = { ".html": "text/html", ".mjs": "text/javascript", ".js": "text/javascript", ".json": "application/json", ".wasm": "application/wasm" };
const VIEWS = ["front", "back"];
const job = JSON.parse(readFileSync(process.argv[2]));

function served(roots) {
  return createServer((request, response) => {
    const path = normalize(decodeURIComponent(new URL(request.url, "http://x").pathname));
    const file = roots.map((root) => join(root, path)).find((one) => existsSync(one));
    if (!file) return response.writeHead(404).end();
    response.writeHead(200, { "content-type": TYPES[extname(file)] ?? "application/octet-stream" });
    createReadStream(file).pipe(response);
  });
}

const server = served([HERE, job.lights_in]);
await new Promise((done) => server.listen(0, "127.0.0.1", done));
const browser = await puppeteer.launch({
  executablePath: job.browser,
  headless: true,
  args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"],
  protocolTimeout: 120_000,
});
const versions = {};
let failed = false;
for (const engine of job.engines) {
  const page = await browser.newPage();
  const said = [];
  page.on("console", (message) => said.push(message.text()));
  page.on("pageerror", (error) => said.push(String(error)));
  try {
    await page.goto(`http://127.0.0.1:${server.address().port}/page.html?engine=${engine}&side=${job.side}`);
    await page.waitForFunction("window.draw || window.failed", { timeout: 60_000 });
    if (await page.evaluate("window.failed")) throw new Error(await page.evaluate("window.failed"));
    versions[engine] = await page.evaluate("window.version");
    mkdirSync(join(job.out, engine), { recursive: true });
    for (const light of job.lights)
      for (const view of VIEWS) {
        const encoded = await page.evaluate((folder, of) => window.draw(folder, of), `lights/${light}/${engine}`, view);
        writeFileSync(join(job.out, engine, `${light}_${view}.f32`), Buffer.from(encoded, "base64"));
      }
  } catch (error) {
    failed = true;
    console.error(`${engine}: ${error.message}\n${said.slice(-5).join("\n")}`);
  }
  await page.close();
}
await browser.close();
server.close();
console.log(JSON.stringify(versions));
process.exit(failed ? 1 : 0);
