import type { RefObject } from 'preact'
import { useCallback, useEffect, useRef, useState } from 'preact/hooks'
import { ask, get, send } from './api/client'
import { explain, type PageError } from './api/page-error'
import { release } from './object-url'

/** Data from the API: undefined at first, then the data or an error message. */
export interface Loaded<T> {
  data: T | undefined
  error: PageError | undefined
  /** Loads again; the current data stays until then. */
  reload: () => void
}

/** Loads a path, and reloads it every `every` milliseconds if that is given. */
export function useLoaded<T>(path: string | undefined, every?: number): Loaded<T> {
  const [state, setState] = useState<{ path?: string | undefined; data?: T; error?: PageError }>({})
  const [round, setRound] = useState(0)
  useEffect(() => {
    if (!path) return
    const stop = new AbortController()
    get<T>(path, stop.signal).then(
      (data) => setState({ path, data }),
      (error: unknown) => {
        if (!stop.signal.aborted) setState((before) => ({ ...before, path, error: explain(error) }))
      },
    )
    const timer = every ? setTimeout(() => setRound((n) => n + 1), every) : undefined
    return () => {
      stop.abort()
      clearTimeout(timer)
    }
  }, [path, round, every])
  const reload = useCallback(() => setRound((n) => n + 1), [])
  const isOfPath = state.path === path
  return { data: isOfPath ? state.data : undefined, error: isOfPath ? state.error : undefined, reload }
}

/** Loads a text, and reloads it every `every` milliseconds if that is given. If a reload fails, the previous text stays. */
export function useText(path: string, every?: number): string {
  const [text, setText] = useState('')
  const [round, setRound] = useState(0)
  useEffect(() => {
    const stop = new AbortController()
    ask(path, { signal: stop.signal }).then((answer) => answer.text()).then(setText).catch(() => {})
    const timer = every ? setTimeout(() => setRound((n) => n + 1), every) : undefined
    return () => {
      stop.abort()
      clearTimeout(timer)
    }
  }, [path, round, every])
  return text
}

/** Whether an element has been near the window. Its content can wait until then. */
export function useSeen<E extends Element>(): [RefObject<E | null>, boolean] {
  const element = useRef<E>(null)
  const [isSeen, setSeen] = useState(false)
  useEffect(() => {
    if (!element.current || isSeen) return
    const watch = new IntersectionObserver(([entry]) => entry?.isIntersecting && setSeen(true), { rootMargin: '200px' })
    watch.observe(element.current)
    return () => watch.disconnect()
  }, [isSeen])
  return [element, isSeen]
}

/** An object URL of an image that needs an API key; undefined until the image has arrived. */
export function usePicture(path: string | undefined): string | undefined {
  const [shown, setShown] = useState<{ path: string; url: string }>()
  useEffect(() => {
    if (!path) return
    const stop = new AbortController()
    ask(path, { signal: stop.signal })
      .then((answer) => answer.blob())
      .then((blob) => {
        if (!stop.signal.aborted) setShown({ path, url: URL.createObjectURL(blob) })
      })
      .catch(() => {})
    return () => stop.abort()
  }, [path])
  useEffect(() => () => {
    release(shown?.url)
  }, [shown])
  return shown && shown.path === path ? shown.url : undefined
}

/** An image that is requested every `every` milliseconds and transferred only if it has changed. `step` is its training step; `why` is the error message. */
export function useWatched(path: string | undefined, every: number): { url?: string; step?: string; why?: string } {
  const [shown, setShown] = useState<{ url?: string; step?: string; why?: string }>({})
  const url = useRef<string | undefined>(undefined)
  useEffect(() => {
    if (!path) return
    let tag = ''
    let timer = 0
    const stop = new AbortController()
    const look = async () => {
      const answer = await send(path, { signal: stop.signal, cache: 'no-store', headers: tag ? { 'If-None-Match': tag } : {} })
      if (answer.ok) {
        tag = answer.headers.get('etag') ?? ''
        const step = answer.headers.get('relume-step')
        release(url.current)
        url.current = URL.createObjectURL(await answer.blob())
        setShown({ url: url.current, ...(step ? { step } : {}) })
      } else if (answer.status !== 304) {
        const problem = (await answer.json().catch(() => null)) as { detail?: string } | null
        setShown((before) => ({ ...before, why: problem?.detail ?? '' }))
      }
    }
    const again = () => void look().catch(() => {}).finally(() => {
      if (!stop.signal.aborted) timer = window.setTimeout(again, every)
    })
    again()
    return () => {
      stop.abort()
      clearTimeout(timer)
    }
  }, [path, every])
  useEffect(() => () => {
    release(url.current)
  }, [])
  return shown
}

/** The title of the page. */
export function useTitle(title: string): void {
  useEffect(() => {
    document.title = `${title} · Relume`
  }, [title])
}
