// web.mjs JOBS BROWSER FOLDER: draws exported files in three.js, Babylon.js and PlayCanvas in headless Chromium, and lists the attributes that each keeps.
//
// FOLDER is where `npm install three @babylonjs/core @babylonjs/loaders playcanvas playwright-core` ran, BROWSER is Chromium. JOBS is the JSON file that
// compare.py writes. A job has `program`, `kind` (`mesh`, `splats` or `kept`) and `file`. For a picture it also has `cameras`, `side`, `pictures` and, for a mesh,
// `light` or `sun`. `kept` writes what the page answers to `answer`. WebGL and WebGPU run on SwiftShader, on the processor.
import { createReadStream, existsSync, readFileSync, statSync, writeFileSync } from 'node:fs'
import { createServer } from 'node:http'
import { createRequire } from 'node:module'
import { extname, join, normalize } from 'node:path'

const [jobsFile, browserProgram, folder] = process.argv.slice(2)
const { chromium } = createRequire(join(folder, 'package.json'))('playwright-core')
const FLAGS = ['--no-sandbox', '--enable-unsafe-webgpu', '--use-angle=swiftshader', '--enable-features=Vulkan', '--use-vulkan=swiftshader', '--ignore-gpu-blocklist']
const TYPES = { '.html': 'text/html', '.js': 'text/javascript', '.mjs': 'text/javascript', '.json': 'application/json', '.wasm': 'application/wasm' }
const IMPORTS = {
  three: '/libraries/three/build/three.module.js',
  'three/webgpu': '/libraries/three/build/three.webgpu.js',
  'three/tsl': '/libraries/three/build/three.tsl.js',
  'three/addons/': '/libraries/three/examples/jsm/',
  '@babylonjs/core': '/libraries/@babylonjs/core/index.js',
  '@babylonjs/core/': '/libraries/@babylonjs/core/',
  '@babylonjs/loaders/': '/libraries/@babylonjs/loaders/',
  playcanvas: '/libraries/playcanvas/build/playcanvas.mjs',
}
const PAGE = `<!doctype html><meta charset="utf-8"><body style="margin: 0"><canvas id="canvas"></canvas>`

/** `three` with another build: the WebGPU renderer must share its classes with the loaders. */
const page = (kind) => {
  const imports = kind === 'splats' ? { ...IMPORTS, three: IMPORTS['three/webgpu'] } : IMPORTS
  return `${PAGE}<script type="importmap">${JSON.stringify({ imports })}</script>`
}

/** Serves the libraries, the pages' scripts beside this file, and the files of the jobs by their paths. */
function serve() {
  const server = createServer((request, response) => {
    const path = decodeURIComponent(new URL(request.url, 'http://localhost').pathname)
    if (path === '/mesh' || path === '/splats') return response.setHeader('Content-Type', 'text/html').end(page(path.slice(1)))
    const file = path.startsWith('/libraries/')
      ? join(folder, 'node_modules', normalize(path.slice('/libraries'.length)))
      : path.startsWith('/files/')
        ? normalize(path.slice('/files'.length))
        : new URL(`.${path}`, import.meta.url).pathname
    if (!existsSync(file) || !statSync(file).isFile()) return response.writeHead(404).end()
    response.setHeader('Content-Type', TYPES[extname(file)] ?? 'application/octet-stream')
    if (path.startsWith('/libraries/')) response.setHeader('Cache-Control', 'max-age=3600')
    return createReadStream(file).pipe(response)
  })
  return new Promise((resolve) => server.listen(0, '127.0.0.1', () => resolve(server)))
}

async function run(browser, base, job) {
  const tab = await browser.newPage()
  const messages = []
  tab.on('console', (message) => ['error', 'warning'].includes(message.type()) && messages.push(message.text()))
  tab.on('pageerror', (error) => messages.push(error.message))
  try {
    await tab.goto(`${base}/${job.kind === 'mesh' ? 'mesh' : 'splats'}`)
    const answer = await tab.evaluate(async (job) => {
      const program = await import(`/${job.program}.mjs`)
      return program[job.kind](job)
    }, { ...job, file: `/files${job.file}`, light: job.light && `/files${job.light}` })
    if (job.kind === 'kept') return writeFileSync(job.answer, JSON.stringify(answer))
    return answer.forEach((url, i) => writeFileSync(job.pictures[i], Buffer.from(url.split(',')[1], 'base64')))
  } catch (error) {
    console.error(`${job.program} ${job.kind} ${job.file}: ${error.message}\n${messages.slice(0, 5).join('\n')}`)
    if (job.kind === 'kept') writeFileSync(job.answer, JSON.stringify({ type: `not read: ${error.message.split('\n')[0]}`, count: 0, attributes: [] }))
  } finally {
    await tab.close()
  }
}

const server = await serve()
const browser = await chromium.launch({ executablePath: browserProgram, args: FLAGS })
for (const job of JSON.parse(readFileSync(jobsFile, 'utf8'))) {
  await run(browser, `http://127.0.0.1:${server.address().port}`, job)
}
await browser.close()
server.close()
