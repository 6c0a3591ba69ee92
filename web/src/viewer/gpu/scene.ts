import type { LightHeader, ModelHeader, Sink } from '../stream'
import { Uniform, code } from './kernels'

/** Components of the engine's parameters that a stream fills, by their names in `Layout`. The model defines those of visibility. */
const PARAMETERS = {
  mean: 3, log_scale: 3, quaternion: 4, opacity: 1, normal: 3, metal: 1, rough: 1, sheen: 1, residual: 3, visibility: 0,
  sampling_rate: 1,
} as const

/** The engine's names of stream fields: without prototypes the engine's residual is the albedo. */
const NAMES: Record<string, string> = { albedo: 'residual' }

/** Maximum number of lights in addition to the tables. */
const MOST_LIGHTS = 4

function storage(device: GPUDevice, label: string, floats: number): GPUBuffer {
  const usage = GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST
  return device.createBuffer({ label, size: 4 * Math.max(4, floats), usage })
}

function write(device: GPUDevice, buffer: GPUBuffer, first: number, values: Float32Array): void {
  device.queue.writeBuffer(buffer, 4 * first, values as Float32Array<ArrayBuffer>)
}

/** A model in device memory, as far as it has arrived. */
export class SceneModel implements Sink<ModelHeader> {
  readonly #device: GPUDevice
  readonly #arrived: () => void
  readonly #first = new Map<string, number>()
  readonly layout: Uniform
  readonly shading: Uniform
  header!: ModelHeader
  params!: GPUBuffer
  means = new Float32Array(0)
  coefficients = 1
  /** Gaussians that have arrived. */
  count = 0

  constructor(device: GPUDevice, arrived: () => void) {
    this.#device = device
    this.#arrived = arrived
    this.layout = new Uniform(device, 'Layout')
    this.shading = new Uniform(device, 'Shading')
  }

  /** Gaussians of the whole model. */
  get total(): number {
    return this.header.records.count
  }

  begin(header: ModelHeader): void {
    this.header = header
    const { shading } = header
    if (shading.shade_at !== 'gaussian') throw new Error('the model is shaded in the pixel')
    this.coefficients = header.records.fields.find(({ name }) => name === 'visibility')?.components ?? 1
    let next = 0
    for (const [name, width] of Object.entries(PARAMETERS)) {
      this.#first.set(name, next)
      this.layout.integers(name, next)
      next += (width || this.coefficients) * this.total
    }
    this.params = storage(this.#device, 'Gaussians', next)
    this.means = new Float32Array(3 * this.total)
    const forms = { visibility: code('VISIBILITY', shading.visibility), diffuse: code('DIFFUSE', shading.diffuse) }
    // The viewer does not show the radiance of the photographs, but the layout needs an offset with three floats per Gaussian: use the means.
    this.layout
      .integers('n', this.total).integers('n_scores', 0).integers('n_visibility', this.coefficients).integers('n_radiance', 1)
      .integers('radiance', 0).integers('normal_form', code('NORMAL', shading.normal))
      .integers('indirect_form', code('INDIRECT', 'gathered')).integers('visibility_form', forms.visibility)
      .integers('diffuse_form', forms.diffuse).integers('shade_at', code('SHADE_AT', shading.shade_at))
      .upload()
    this.shading
      .integers('visibility_form', forms.visibility).integers('diffuse_form', forms.diffuse)
      .integers('shade_at', code('SHADE_AT', shading.shade_at)).integers('srgb', Number(shading.srgb))
      .integers('conserves_energy', Number(shading.conserves_energy))
      .upload()
  }

  records(first: number, fields: Map<string, Float32Array>): void {
    let count = 0
    for (const [field, values] of fields) {
      const name = NAMES[field] ?? field
      const start = this.#first.get(name)
      if (start === undefined) continue
      const width = PARAMETERS[name as keyof typeof PARAMETERS] || this.coefficients
      write(this.#device, this.params, start + width * first, values)
      if (name === 'mean') {
        this.means.set(values, 3 * first)
        count = values.length / 3
      }
    }
    this.count = first + count
    this.#arrived()
  }
}

/** A light in device memory, as far as it has arrived. */
export class SceneLight implements Sink<LightHeader> {
  readonly #device: GPUDevice
  readonly #arrived: () => void
  readonly tables: Uniform
  header!: LightHeader
  reflectance!: GPUBuffer
  values!: GPUBuffer
  /** The gathered light of all Gaussians, then the arriving fraction of each light. */
  gathered!: GPUBuffer
  map!: GPUBuffer
  count = 0

  constructor(device: GPUDevice, arrived: () => void) {
    this.#device = device
    this.#arrived = arrived
    this.tables = new Uniform(device, 'Tables')
  }

  begin(header: LightHeader, arrays: Map<string, Float32Array>): void {
    this.header = header
    const put = (name: string) => {
      const values = arrays.get(name) ?? new Float32Array(0)
      const buffer = storage(this.#device, name, values.length)
      write(this.#device, buffer, 0, values)
      return buffer
    }
    this.reflectance = put('reflectance')
    this.values = put('tables')
    this.map = put('map')
    this.gathered = storage(this.#device, 'gathered', 10 * header.records.count)
    this.#describe(header)
  }

  /** Sets the offsets of the tables: diffuse transfer, specular levels, irradiance of the lights. */
  #describe({ diffuse_nodes, coefficients, specular_nodes, lights }: LightHeader): void {
    let next = 6 * diffuse_nodes ** 2 * 3 * coefficients
    const first = specular_nodes.map((nodes) => {
      const start = next
      next += 6 * nodes ** 2 * 3
      return start
    })
    this.tables
      .integers('diffuse_n', diffuse_nodes).integers('coefficients', coefficients)
      .integers('n_specular', specular_nodes.reduce((sum, nodes) => sum + 6 * nodes ** 2, 0))
      .integers('specular_n', ...specular_nodes).integers('specular_first', ...first)
      .integers('n_lights', Math.min(lights.length, MOST_LIGHTS)).integers('first_light', next)
      .floats('lights', ...lights.slice(0, MOST_LIGHTS).flatMap(({ direction, radius }) => [...direction, radius]))
  }

  records(first: number, fields: Map<string, Float32Array>): void {
    const [gathered, blocked, arriving] = ['gathered', 'blocked', 'arriving'].map((name) => fields.get(name))
    if (!gathered || !blocked || !arriving) throw new Error('the light lacks what reaches the Gaussians')
    const count = gathered.length / 3
    const both = new Float32Array(6 * count)
    for (let i = 0; i < count; i++) {
      both.set(gathered.subarray(3 * i, 3 * i + 3), 6 * i)
      both.set(blocked.subarray(3 * i, 3 * i + 3), 6 * i + 3)
    }
    write(this.#device, this.gathered, 6 * first, both)
    write(this.#device, this.gathered, 6 * this.header.records.count + MOST_LIGHTS * first, arriving)
    this.count = first + count
    this.#arrived()
  }

  destroy(): void {
    for (const buffer of [this.tables.buffer, this.reflectance, this.values, this.gathered, this.map]) buffer?.destroy()
  }
}
