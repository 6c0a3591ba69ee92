import { useEffect, useState } from 'preact/hooks'

/** The current route: `#/models/ID?light=sunset`. */
export interface Place {
  /** `['models', 'ID']` */
  path: string[]
  query: URLSearchParams
}

export function place(hash: string): Place {
  const [path = '', query = ''] = hash.replace(/^#\/?/, '').split('?', 2)
  return { path: path.split('/').filter(Boolean).map(decoded), query: new URLSearchParams(query) }
}

/** A part of a path; as it is if somebody typed a wrong escape. */
function decoded(part: string): string {
  try {
    return decodeURIComponent(part)
  } catch {
    return part
  }
}

/** The route in the URL. */
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

/** Replaces the route in the URL without a new history entry. */
export function describe(path: string[], query: Record<string, string>): void {
  history.replaceState(history.state, '', link(path, query))
}
