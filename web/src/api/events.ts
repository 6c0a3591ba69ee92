import { ask, Refused } from './client'
import type { JobState, Progress } from './types'

/** An event of a job. */
export type JobEvent =
  | { kind: 'state'; at: string; state: JobState }
  | ({ kind: 'progress'; at: string } & Progress)
  | { kind: 'checkpoint'; at: string; step: number }
  | { kind: 'warning'; at: string; message: string }

const ENDED: JobState[] = ['succeeded', 'rejected', 'failed', 'cancelled']

/** Whether a job is in a final state. */
export function hasEnded(state: JobState | undefined): boolean {
  return state !== undefined && ENDED.includes(state)
}

/** Delay before the client reopens a broken stream, milliseconds. */
const AGAIN = 1500

/** Parses one block of a stream of server-sent events. */
export function parseBlock(block: string): { id: string; event: string; data: string } {
  const fields = { id: '', event: 'message', data: '' }
  for (const line of block.split('\n')) {
    const colon = line.indexOf(':')
    if (colon <= 0) continue
    const name = line.slice(0, colon)
    const value = line.slice(colon + 1).replace(/^ /, '')
    if (name === 'data') fields.data += fields.data ? `\n${value}` : value
    else if (name === 'id' || name === 'event') fields[name] = value
  }
  return fields
}

/** Yields all events of a job until the job ends. After a broken connection it resumes after the last event. */
export async function* jobEvents(job: string, signal: AbortSignal): AsyncGenerator<JobEvent[]> {
  let last = ''
  while (!signal.aborted) {
    try {
      const headers: Record<string, string> = { Accept: 'text/event-stream', ...(last ? { 'Last-Event-ID': last } : {}) }
      const answer = await ask(`v1/jobs/${job}/events`, { headers, signal })
      for await (const blocks of blocksOf(answer)) {
        const events: JobEvent[] = []
        for (const block of blocks) {
          const { id, event, data } = parseBlock(block)
          if (id) last = id
          if (data) events.push({ kind: event, ...JSON.parse(data) } as JobEvent)
        }
        if (events.length) yield events
        if (events.some((event) => event.kind === 'state' && hasEnded(event.state))) return
      }
    } catch (error) {
      if (signal.aborted || error instanceof Refused) return
    }
    // The connection broke, or the server is shutting down.
    await new Promise((done) => setTimeout(done, AGAIN))
  }
}

/** Yields the complete blocks of a stream, in the groups in which they arrive. */
async function* blocksOf(answer: Response): AsyncGenerator<string[]> {
  if (!answer.body) return
  let rest = ''
  const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader()
  for (;;) {
    const { done, value } = await reader.read()
    if (done) return
    const blocks = (rest + value).split('\n\n')
    rest = blocks.pop() ?? ''
    yield blocks
  }
}
