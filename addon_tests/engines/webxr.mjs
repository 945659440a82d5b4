// Runs webxr.html beside an export of WebXR: node webxr.mjs FOLDER BROWSER SECONDS; the lights that the app had, as JSON.
import { createReadStream, existsSync } from "node:fs";
import { createServer } from "node:http";
import { extname, join } from "node:path";
import puppeteer from "puppeteer-core";

const [folder, browserPath, seconds] = process.argv.slice(2);
const TYPES = { ".html": "text/html", ".js": "text/javascript", ".json": "application/json" };
const server = createServer((request, response) => {
  const path = new URL(request.url, "http://x").pathname;
  const file = path.startsWith("/lights/") ? join(folder, path.slice(8)) : join(import.meta.dirname, path);
  if (!existsSync(file)) return response.writeHead(404).end();
  response.writeHead(200, { "content-type": TYPES[extname(file)] ?? "application/octet-stream" });
  createReadStream(file).pipe(response);
});
await new Promise((done) => server.listen(0, "127.0.0.1", done));
const browser = await puppeteer.launch({
  executablePath: browserPath,
  headless: true,
  args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
});
const page = await browser.newPage();
page.on("console", (message) => message.type() === "error" && console.error(message.text()));
await page.goto(`http://localhost:${server.address().port}/webxr.html`);
await page.waitForFunction("window.failed || window.seen?.length", { timeout: 30_000 });
await new Promise((done) => setTimeout(done, Number(seconds) * 1000));
const failed = await page.evaluate("window.failed ?? null");
if (failed) console.error(failed);
console.log(JSON.stringify(await page.evaluate("window.seen ?? []")));
await browser.close();
server.close();
process.exit(failed ? 1 : 0);
