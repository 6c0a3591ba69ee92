/** Runs jobs one after another: urgent ones first, else in the order in which they were added. */
export class SerialQueue {
  readonly #waiting: (() => Promise<unknown>)[] = []
  #isBusy = false

  add<T>(job: () => Promise<T>, isUrgent = false): Promise<T> {
    return new Promise((resolve, reject) => {
      const run = () => job().then(resolve, reject)
      if (isUrgent) this.#waiting.unshift(run)
      else this.#waiting.push(run)
      if (!this.#isBusy) void this.#work()
    })
  }

  async #work(): Promise<void> {
    this.#isBusy = true
    for (let run = this.#waiting.shift(); run; run = this.#waiting.shift()) await run()
    this.#isBusy = false
  }
}
