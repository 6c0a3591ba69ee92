import generated from '../shaders.json'

/** Names of the engine's shaders, which the engine's build writes to shaders.json. */
export type KernelName = keyof typeof generated.shaders

/** Names of the uniform structs of the shaders. */
export type StructName = 'Camera' | 'Layout' | 'Shading' | 'Tables' | 'Drawing' | 'Present'

const { shaders, structs, codes } = generated

/** Maximum number of storage buffers in one shader stage. */
export const STORAGE_BUFFERS = Math.max(
  ...Object.values(shaders).map(({ bindings }) => bindings.filter((kind) => kind.includes('storage')).length),
)

/** The shader constant of a form of the model, e.g. `NORMAL` `shortest_axis`. */
export function code(kind: string, form: string): number {
  const name = `${kind}_${form.toUpperCase()}`
  const found = (codes as Record<string, number | undefined>)[name]
  if (found === undefined) throw new Error(`this viewer does not know ${name.toLowerCase()}`)
  return found
}

/** Compiles a shader for models with `coefficients` visibility coefficients. */
export function module(device: GPUDevice, name: KernelName, coefficients: number): GPUShaderModule {
  return device.createShaderModule({ label: name, code: `const S = ${coefficients}u;\n${shaders[name].source}` })
}

/** The bind group layout of a shader. */
export function bindings(device: GPUDevice, name: KernelName, visibility: GPUShaderStageFlags): GPUBindGroupLayout {
  const entry = (kind: string, binding: number): GPUBindGroupLayoutEntry =>
    kind === 'texture'
      ? { binding, visibility: GPUShaderStage.FRAGMENT, texture: { sampleType: 'unfilterable-float' } }
      : { binding, visibility, buffer: { type: kind as GPUBufferBindingType } }
  return device.createBindGroupLayout({ label: name, entries: shaders[name].bindings.map(entry) })
}

/** A struct in a uniform buffer. Methods set members by name; `upload` writes them to the device if they have changed. */
export class Uniform {
  readonly buffer: GPUBuffer
  readonly #device: GPUDevice
  readonly #members: Record<string, number | undefined>
  readonly #bytes: ArrayBuffer
  #changed = true

  constructor(device: GPUDevice, name: StructName) {
    const { size, members } = structs[name]
    this.#device = device
    this.#members = members
    this.#bytes = new ArrayBuffer(size)
    this.buffer = device.createBuffer({ label: name, size: Math.ceil(size / 16) * 16, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST })
  }

  floats(member: string, ...values: number[]): this {
    return this.#set(new Float32Array(this.#bytes, this.#at(member), values.length), values)
  }

  integers(member: string, ...values: number[]): this {
    return this.#set(new Uint32Array(this.#bytes, this.#at(member), values.length), values)
  }

  upload(): void {
    if (this.#changed) this.#device.queue.writeBuffer(this.buffer, 0, this.#bytes)
    this.#changed = false
  }

  #at(member: string): number {
    const at = this.#members[member]
    if (at === undefined) throw new Error(`no member ${member}`)
    return at
  }

  #set(place: Float32Array | Uint32Array, values: number[]): this {
    place.set(values)
    this.#changed = true
    return this
  }
}
