import { isPhotograph, type Dropped, type Selection } from './api/upload'

/** Photographs that were dropped in this tab, by capture: the server keeps them in the archive and does not give them back one by one. */
const known = new Map<string, Dropped[]>()

export function photographsOf(what: Selection): Dropped[] {
  return 'files' in what ? what.files.filter(({ path }) => isPhotograph(path)) : []
}

export function remember(capture: string, photographs: Dropped[]): void {
  if (photographs.length) known.set(capture, photographs)
}

export function remembered(capture: string): Dropped[] {
  return known.get(capture) ?? []
}

/** The photograph that a camera's name means, if it was dropped in this tab. */
export function photograph(capture: string, name: string): File | undefined {
  return remembered(capture).find(({ path }) => path === name || path.endsWith(`/${name}`))?.file
}
