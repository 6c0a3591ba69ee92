/** Reads the streams of docs/viewer-stream.md while they arrive. */

import type { PhotographedViews } from './photographed'

const VERSION = 1

/** How a quantity is stored. */
export interface Quantity {
  name: string
  type: 'f32' | 'f16' | 'u16' | 'u8'
  components: number
  count: number
  /** For `f16`: the factor of the stored values. */
  scale?: number
  /** For `u16` and `u8`: the bounds of each component. */
  low?: number[]
  high?: number[]
}

interface Layout {
  arrays: Quantity[]
  records: { count: number; stride: number; fields: Quantity[] }
}

/** The header of a model stream. */
export interface ModelHeader extends Layout {
  shading: {
    visibility: string
    diffuse: string
    conserves_energy: boolean
    shade_at: string
    normal: string
    low_pass: number
    low_pass_compensation: boolean
    srgb: boolean
  }
  /** The transform from capture to model space: `scale * (x + offset)`. */
  world_scale: number
  world_offset: [number, number, number]
  /** The initial view, capture units. */
  framing: { eye: [number, number, number]; target: [number, number, number]; fov_deg: number }
  /** Absent if the model does not record its photographs. */
  photographed_views?: PhotographedViews
}

/** The header of a light stream. */
export interface LightHeader extends Layout {
  diffuse_nodes: number
  coefficients: number
  specular_nodes: number[]
  lights: { direction: [number, number, number]; radius: number }[]
  map?: { width: number; height: number }
}

/** Receives the decoded data of a stream. */
export interface Sink<Header extends Layout> {
  /** Called once, with all arrays. */
  begin(header: Header, arrays: Map<string, Float32Array>): void
  /** Called with the values of the records from `first` on, by field: `[record][component]`. */
  records(first: number, fields: Map<string, Float32Array>): void
}

const BYTES = { f32: 4, f16: 2, u16: 2, u8: 1 } as const

/** Reads a stream from a response. `loaded` receives the bytes so far and their total. Rejects if the format or version is wrong or the stream is truncated. */
export async function readStream<Header extends Layout>(
  answer: Response,
  magic: string,
  sink: Sink<Header>,
  loaded?: (bytes: number, total: number | undefined) => void,
): Promise<void> {
  const reader = new Reader<Header>(magic, sink)
  if (!answer.body) throw new Error('the stream is empty')
  // The length of a compressed answer is not that of its content.
  const length = answer.headers.has('content-encoding') ? 0 : Number(answer.headers.get('content-length'))
  let bytes = 0
  for await (const piece of pieces(answer.body)) {
    bytes += piece.length
    loaded?.(bytes, length || undefined)
    reader.take(piece)
  }
  reader.end()
}

/** Yields the chunks of a stream. Safari has no async iterator for streams. */
async function* pieces(body: ReadableStream<Uint8Array>): AsyncGenerator<Uint8Array> {
  const reader = body.getReader()
  try {
    for (;;) {
      const { done, value } = await reader.read()
      if (done) return
      yield value
    }
  } finally {
    reader.releaseLock()
  }
}

class Reader<Header extends Layout> {
  readonly #magic: string
  readonly #sink: Sink<Header>
  /** Bytes that have arrived and have not been parsed. */
  #rest = new Uint8Array(0)
  #header: Header | undefined
  #begun = false
  #done = 0

  constructor(magic: string, sink: Sink<Header>) {
    this.#magic = magic
    this.#sink = sink
  }

  take(piece: Uint8Array): void {
    const all = new Uint8Array(this.#rest.length + piece.length)
    all.set(this.#rest)
    all.set(piece, this.#rest.length)
    this.#rest = all
    this.#header ??= this.#readHeader()
    if (this.#header && !this.#begun) this.#begun = this.#readArrays(this.#header)
    if (this.#header && this.#begun) this.#readRecords(this.#header)
  }

  end(): void {
    if (!this.#header || !this.#begun || this.#done < this.#header.records.count) throw new Error('the stream was cut off')
  }

  #view(): DataView {
    return new DataView(this.#rest.buffer, this.#rest.byteOffset, this.#rest.byteLength)
  }

  #skip(bytes: number): void {
    this.#rest = this.#rest.subarray(bytes)
  }

  #readHeader(): Header | undefined {
    if (this.#rest.length < 12) return undefined
    const view = this.#view()
    const magic = String.fromCharCode(...this.#rest.subarray(0, 4))
    const version = view.getUint32(4, true)
    if (magic !== this.#magic || version !== VERSION) throw new Error(`the stream is ${magic} ${version}, not ${this.#magic} ${VERSION}`)
    const end = 12 + view.getUint32(8, true)
    if (this.#rest.length < end) return undefined
    const header = JSON.parse(new TextDecoder().decode(this.#rest.subarray(12, end))) as Header
    this.#skip(end)
    return header
  }

  #readArrays(header: Header): boolean {
    const sizes = header.arrays.map((array) => rowBytes(array) * array.count)
    const padded = sizes.map((size) => Math.ceil(size / 4) * 4)
    const end = padded.reduce((sum, size) => sum + size, 0)
    if (this.#rest.length < end) return false
    const view = this.#view()
    const arrays = new Map<string, Float32Array>()
    let at = 0
    header.arrays.forEach((array, k) => {
      arrays.set(array.name, decode(view, array, at, rowBytes(array), array.count))
      at += padded[k] ?? 0
    })
    this.#skip(end)
    this.#sink.begin(header, arrays)
    return true
  }

  #readRecords(header: Header): void {
    const { stride, fields, count } = header.records
    const rows = Math.min(Math.floor(this.#rest.length / stride), count - this.#done)
    if (rows === 0) return
    const view = this.#view()
    const decoded = new Map<string, Float32Array>()
    let at = 0
    for (const field of fields) {
      decoded.set(field.name, decode(view, field, at, stride, rows))
      at += rowBytes(field)
    }
    this.#skip(rows * stride)
    const first = this.#done
    this.#done += rows
    this.#sink.records(first, decoded)
  }
}

function rowBytes({ type, components }: Quantity): number {
  return BYTES[type] * components
}

/** Decodes `rows` rows of a quantity; the first is at `start`, and they are `stride` bytes apart. */
function decode(view: DataView, quantity: Quantity, start: number, stride: number, rows: number): Float32Array {
  const { components, type } = quantity
  const out = new Float32Array(rows * components)
  const read = readerOf(view, quantity)
  for (let row = 0; row < rows; row++) {
    for (let k = 0; k < components; k++) out[row * components + k] = read(start + row * stride + k * BYTES[type], k)
  }
  return out
}

/** Returns a function that decodes component `k` at a byte offset. */
function readerOf(view: DataView, { type, scale = 1, low = [], high = [] }: Quantity): (at: number, k: number) => number {
  const between = (share: number, k: number) => (low[k] ?? 0) + ((high[k] ?? 0) - (low[k] ?? 0)) * share
  switch (type) {
    case 'f32':
      return (at) => view.getFloat32(at, true)
    case 'f16':
      return (at) => (halfs()[view.getUint16(at, true)] ?? 0) * scale
    case 'u16':
      return (at, k) => between(view.getUint16(at, true) / 65535, k)
    case 'u8':
      return (at, k) => between(view.getUint8(at) / 255, k)
  }
}

let table: Float32Array | undefined

/** A table of the values of all half floats. */
function halfs(): Float32Array {
  table ??= Float32Array.from({ length: 65536 }, (_, bits) => {
    const [exponent, fraction] = [(bits >> 10) & 31, bits & 1023]
    const size = exponent === 0 ? fraction * 2 ** -24 : (1 + fraction / 1024) * 2 ** (exponent - 15)
    return bits >> 15 ? -size : size
  })
  return table
}
