import type { Problem } from './types'

/** Name of the API key in session storage, which the browser keeps until the tab is closed. */
const KEY = 'relume-api-key'

/** An error response of the server, with the server's message. */
export class Refused extends Error {
  readonly status: number
  readonly problem: Problem | null
  /** Seconds after which the client may retry. */
  readonly retryAfter: number | undefined

  constructor(status: number, problem: Problem | null, retryAfter?: number) {
    super(problem?.detail ?? problem?.title ?? `the server answered ${status}`)
    this.status = status
    this.problem = problem
    this.retryAfter = retryAfter
  }
}

/** The API key of requests. */
export function apiKey(): string | undefined {
  return sessionStorage.getItem(KEY) ?? undefined
}

export function setApiKey(key: string | undefined): void {
  if (key) sessionStorage.setItem(KEY, key)
  else sessionStorage.removeItem(KEY)
}

let askForKey: (() => Promise<void>) | undefined
let asking: Promise<void> | undefined

/** Sets the function that asks the user for a key; its promise resolves when a key has been entered. */
export function onKeyNeeded(ask: () => Promise<void>): void {
  askForKey = ask
}

/** Asks the user for a key. All requests that need one wait for the same dialog. */
export async function keyNeeded(): Promise<void> {
  if (!askForKey) return
  asking ??= askForKey().finally(() => (asking = undefined))
  await asking
}

/** The URL of an API path, relative to the URL of this page. */
export function address(path: string): string {
  return new URL(path.replace(/^\//, ''), document.baseURI.replace(/#.*$/, '')).href
}

export function authorization(): Record<string, string> {
  const key = apiKey()
  return key ? { Authorization: `Bearer ${key}` } : {}
}

/** Sends a request and returns the response, whatever its status. If the server requires a valid key, asks the user for one and retries. */
export async function send(path: string, init: RequestInit = {}): Promise<Response> {
  for (;;) {
    // While the dialog asks for a key, a request without one would only be refused again.
    if (asking) await asking
    init.signal?.throwIfAborted()
    const sent = apiKey()
    const answer = await fetch(address(path), { ...init, headers: { ...authorization(), ...init.headers } })
    if (answer.status !== 401) return answer
    // The user may have entered a key meanwhile.
    if (sent === apiKey()) await keyNeeded()
  }
}

/** The error of an error response. */
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
export async function put<T>(path: string, body: unknown): Promise<T> {
  const init = { method: 'PUT', body: JSON.stringify(body), headers: { 'Content-Type': 'application/json' } }
  return (await ask(path, init)).json() as Promise<T>
}

/** Changes fields of a resource by a JSON merge patch. @throws {Refused} */
export async function patch<T>(path: string, body: unknown): Promise<T> {
  const init = { method: 'PATCH', body: JSON.stringify(body), headers: { 'Content-Type': 'application/json' } }
  return (await ask(path, init)).json() as Promise<T>
}

/** @throws {Refused} */
export async function remove(path: string): Promise<void> {
  await ask(path, { method: 'DELETE' })
}
