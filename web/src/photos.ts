import { isPhotograph, type Dropped, type Selection } from './api/upload'

/** The photographs among what was dropped: they are shown while it is sent. */
export function photographsOf(what: Selection): Dropped[] {
  return 'files' in what ? what.files.filter(({ path }) => isPhotograph(path)) : []
}
