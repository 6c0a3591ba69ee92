const BITS = 11
const BUCKETS = 1 << BITS

/** Sorts points by depth along a direction, nearest first, ties by index. Uses a radix sort of the bits of the depths. */
export class DepthSort {
  #keys = new Uint32Array(0)
  #order = new Uint32Array(0)
  #spare = new Uint32Array(0)

  /** The order of the first `count` of `points`, `[point][xyz]`. Valid until the next call. */
  sort(points: Float32Array, count: number, [x, y, z]: [number, number, number]): Uint32Array<ArrayBuffer> {
    if (this.#keys.length < count) {
      const room = points.length / 3
      this.#keys = new Uint32Array(room)
      this.#order = new Uint32Array(room)
      this.#spare = new Uint32Array(room)
    }
    const keys = this.#keys
    const depths = new Float32Array(keys.buffer)
    for (let i = 0; i < count; i++) {
      // Adding 0 converts -0 to 0.
      depths[i] = x * points[3 * i]! + y * points[3 * i + 1]! + z * points[3 * i + 2]! + 0
      // The bits of positive floats sort in ascending order, those of negative floats in descending order.
      const bits = keys[i]!
      keys[i] = bits >>> 31 ? ~bits : bits | 0x80000000
      this.#order[i] = i
    }
    for (let shift = 0; shift < 32; shift += BITS) this.#pass(count, shift)
    return this.#order.subarray(0, count) as Uint32Array<ArrayBuffer>
  }

  #pass(count: number, shift: number): void {
    const [keys, order, sorted] = [this.#keys, this.#order, this.#spare]
    const place = new Uint32Array(BUCKETS)
    for (let i = 0; i < count; i++) place[(keys[i]! >>> shift) & (BUCKETS - 1)]!++
    let before = 0
    for (let bucket = 0; bucket < BUCKETS; bucket++) {
      const size = place[bucket]!
      place[bucket] = before
      before += size
    }
    for (let i = 0; i < count; i++) {
      const bucket = (keys[order[i]!]! >>> shift) & (BUCKETS - 1)
      sorted[place[bucket]!++] = order[i]!
    }
    this.#order = sorted
    this.#spare = order
  }
}
