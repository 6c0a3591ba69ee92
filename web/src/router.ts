import { useEffect, useState } from 'preact/hooks'

/** Where in the app somebody is: `#/models/ID?light=sunset`. */
export interface Place {
  /** `['models', 'ID']` */
  path: string[]
  query: URLSearchParams
}

export function place(hash: string): Place {
  const [path = '', query = ''] = hash.replace(/^#\/?/, '').split('?', 2)
  return { path: path.split('/').filter(Boolean).map(decodeURIComponent), query: new URLSearchParams(query) }
}

/** The place that the address names. */
export function usePlace(): Place {
  const [hash, setHash] = useState(location.hash)
  useEffect(() => {
    const changed = () => setHash(location.hash)
    addEventListener('hashchange', changed)
    return () => removeEventListener('hashchange', changed)
  }, [])
  return place(hash)
}

export function link(path: string[], query?: Record<string, string>): string {
  const search = query && Object.keys(query).length ? `?${new URLSearchParams(query)}` : ''
  return `#/${path.map(encodeURIComponent).join('/')}${search}`
}

export function go(to: string): void {
  location.hash = to
}

/** Names what is seen in the address, without a step in the history. */
export function describe(path: string[], query: Record<string, string>): void {
  history.replaceState(history.state, '', link(path, query))
}
