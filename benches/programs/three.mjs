// The page of web.mjs for three.js. A mesh is drawn by the WebGL renderer, Gaussians by the WebGPU renderer.
import * as THREE from 'three'
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js'
import { HDRLoader } from 'three/addons/loaders/HDRLoader.js'

/** The camera of a job (camera to world, +Z up, row by row) for a scene with +Y up. */
function cameraOf({ matrix, fov }) {
  const camera = new THREE.PerspectiveCamera(fov, 1, 0.05, 50)
  const [x, y, z, w] = matrix
  camera.matrixAutoUpdate = false
  camera.matrix.set(...x, ...z, ...y.map((v) => -v), ...w)
  camera.updateMatrixWorld(true)
  return camera
}

async function lightBy(scene, { light, sun }) {
  if (light) {
    scene.environment = await new HDRLoader().loadAsync(light)
    scene.environment.mapping = THREE.EquirectangularReflectionMapping
  }
  if (sun) {
    const lamp = new THREE.DirectionalLight(0xffffff, Math.PI)
    lamp.position.set(sun[0], sun[2], -sun[1]).multiplyScalar(4)
    lamp.castShadow = true
    lamp.shadow.mapSize.set(2048, 2048)
    Object.assign(lamp.shadow.camera, { left: -1.5, right: 1.5, top: 1.5, bottom: -1.5, near: 0.5, far: 8 })
    lamp.shadow.normalBias = 0.02
    scene.add(lamp)
  }
}

export async function mesh(job) {
  const canvas = document.querySelector('canvas')
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true })
  renderer.setSize(job.side, job.side)
  renderer.setClearColor(0xffffff, 1)
  renderer.shadowMap.enabled = true
  const scene = new THREE.Scene()
  await lightBy(scene, job)
  const { scene: model } = await new GLTFLoader().loadAsync(job.file)
  model.traverse((part) => Object.assign(part, { castShadow: true, receiveShadow: true }))
  scene.add(model)
  return job.cameras.map((camera) => {
    renderer.render(scene, cameraOf(camera))
    return canvas.toDataURL('image/png')
  })
}

async function loadSplats(file) {
  if (file.endsWith('.ply')) {
    const { GaussianSplatPLYLoader } = await import('three/addons/loaders/GaussianSplatPLYLoader.js')
    return new GaussianSplatPLYLoader().loadAsync(file)
  }
  const { GLTFGaussianSplatLoaderExtension } = await import('three/addons/loaders/GLTFGaussianSplatLoaderExtension.js')
  const loader = new GLTFLoader()
  loader.register((parser) => new GLTFGaussianSplatLoaderExtension(parser))
  return (await loader.loadAsync(file)).scene
}

export async function splats(job) {
  const canvas = document.querySelector('canvas')
  const renderer = new THREE.WebGPURenderer({ canvas, antialias: false })
  await renderer.init()
  renderer.setSize(job.side, job.side)
  renderer.setClearColor(0xffffff, 1)
  // The loader takes the colours of the file, which are sRGB, for linear ones.
  renderer.outputColorSpace = THREE.LinearSRGBColorSpace
  const scene = new THREE.Scene()
  scene.add(await loadSplats(job.file))
  const pictures = []
  for (const camera of job.cameras) {
    const view = cameraOf(camera)
    // The Gaussians are sorted while a frame is drawn, so the first frames may have the order of another view.
    for (let frame = 0; frame < 4; frame++) {
      await renderer.renderAsync(scene, view)
      await new Promise((resolve) => setTimeout(resolve, 100))
    }
    await renderer.renderAsync(scene, view)
    pictures.push(canvas.toDataURL('image/png'))
  }
  return pictures
}

export async function kept({ file }) {
  const found = { type: 'nothing', count: 0, attributes: [] }
  const root = await loadSplats(file)
  const look = (part) => {
    const geometry = part.geometry ?? (part.attributes && part)
    if (!geometry) return
    const { position } = geometry.attributes
    Object.assign(found, { type: part.type, count: part.splatCount ?? position?.count ?? 0, attributes: Object.keys(geometry.attributes) })
  }
  if (root.traverse) root.traverse(look)
  else look(root)
  return found
}
