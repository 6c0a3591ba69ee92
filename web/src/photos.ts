import { isPhotograph, type Dropped, type Selection } from './api/upload'

/** The photographs among the dropped files, which the page shows during the upload. */
export function photographsOf(what: Selection): Dropped[] {
  return 'files' in what ? what.files.filter(({ path }) => isPhotograph(path)) : []
}
