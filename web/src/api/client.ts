import type { Problem } from './types'

/** Where the key is kept: until the tab is closed. */
const KEY = 'relume-api-key'

/** What the server refused, in its own words. */
export class Refused extends Error {
  readonly status: number
  /** The kind, e.g. `not-found`. */
  readonly kind: string
  /** Seconds after which to ask again. */
  readonly retryAfter: number | undefined

  constructor(status: number, problem: Problem | null, retryAfter?: number) {
    super(problem?.detail ?? problem?.title ?? `the server answered ${status}`)
    this.status = status
    this.kind = problem?.type.split(':').pop() ?? ''
    this.retryAfter = retryAfter
  }
}

/** The key that requests are made with. */
export function apiKey(): string | undefined {
  return sessionStorage.getItem(KEY) ?? undefined
}

export function setApiKey(key: string | undefined): void {
  if (key) sessionStorage.setItem(KEY, key)
  else sessionStorage.removeItem(KEY)
}

let askForKey: (() => Promise<void>) | undefined
let asking: Promise<void> | undefined

/** `ask` is called when the server wants a key, and ends when there is one. */
export function onKeyNeeded(ask: () => Promise<void>): void {
  askForKey = ask
}

/** Asks the person for a key; all requests that need one wait for the same answer. */
export async function keyNeeded(): Promise<void> {
  if (!askForKey) return
  asking ??= askForKey().finally(() => (asking = undefined))
  await asking
}

/** A path of the API as an address, below wherever this page is. */
export function address(path: string): string {
  return new URL(path.replace(/^\//, ''), document.baseURI.replace(/#.*$/, '')).href
}

export function authorization(): Record<string, string> {
  const key = apiKey()
  return key ? { Authorization: `Bearer ${key}` } : {}
}

/** The answer of the server, whatever its status is. Without a key that is good, the person is asked for one first. */
export async function send(path: string, init: RequestInit = {}): Promise<Response> {
  for (;;) {
    const sent = apiKey()
    const answer = await fetch(address(path), { ...init, headers: { ...authorization(), ...init.headers } })
    if (answer.status !== 401) return answer
    // Somebody may have entered one meanwhile.
    if (sent === apiKey()) await keyNeeded()
  }
}

/** Why an answer is a refusal. */
export async function refusal(answer: Response): Promise<Refused> {
  const problem = (await answer.json().catch(() => null)) as Problem | null
  const retryAfter = answer.headers.get('retry-after')
  return new Refused(answer.status, problem, retryAfter ? Number(retryAfter) : undefined)
}

/** @throws {Refused} */
export async function ask(path: string, init: RequestInit = {}): Promise<Response> {
  const answer = await send(path, init)
  if (!answer.ok) throw await refusal(answer)
  return answer
}

/** @throws {Refused} */
export async function get<T>(path: string, signal?: AbortSignal): Promise<T> {
  return (await ask(path, signal ? { signal } : {})).json() as Promise<T>
}

/** @throws {Refused} */
export async function post<T>(path: string, body?: unknown, headers: Record<string, string> = {}): Promise<T> {
  const json = body === undefined ? {} : { body: JSON.stringify(body), headers: { 'Content-Type': 'application/json', ...headers } }
  return (await ask(path, { method: 'POST', ...json })).json() as Promise<T>
}

/** @throws {Refused} */
export async function remove(path: string): Promise<void> {
  await ask(path, { method: 'DELETE' })
}

/** What went wrong, for people. */
export function message(error: unknown): string {
  if (error instanceof Refused) return error.message
  if (error instanceof TypeError) return 'the server cannot be reached'
  return error instanceof Error ? error.message : String(error)
}
