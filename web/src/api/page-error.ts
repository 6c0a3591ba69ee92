import { Refused } from './client'
import type { Problem } from './types'

/** An error in the words of the page. */
export interface PageError {
  /** What happened, one sentence. */
  what: string
  /** What the user can do, one sentence. */
  remedy?: string
  /** The message of the server, for those who want to know more. */
  detail?: string
}

/** What happened if a resource does not exist. */
export const GONE = 'The server does not have this.'

/** What happened and what to do, by the kind of the problem (docs/errors.md). */
const KINDS: Record<string, Omit<PageError, 'detail'>> = {
  'not-found': { what: GONE, remedy: 'Somebody may have deleted it, or the link is incomplete.' },
  forbidden: { what: 'Your key does not permit this.', remedy: 'Ask the operator of the server for a key with more rights.' },
  'too-large': { what: 'This is larger than the server accepts.', remedy: 'Send fewer or smaller photographs, or ask the operator to raise the limit.' },
  'needs-memory': { what: 'The server has too little memory for this.', remedy: 'Choose a smaller size.' },
  'rate-limited': { what: 'Too many requests were sent.', remedy: 'Wait a minute, then try again.' },
  busy: { what: 'The server is busy.', remedy: 'Try again in a moment.' },
  'quota-exceeded': { what: 'You have reached a limit of this server.', remedy: 'Delete something that you no longer need, or wait until running work has ended.' },
  'storage-limit': { what: 'The storage of the server is full.', remedy: 'Delete something that you no longer need, or tell the operator.' },
  'insufficient-storage': { what: 'The disk of the server is full.', remedy: 'Delete something that you no longer need, or tell the operator.' },
  timeout: { what: 'The transfer took too long.', remedy: 'Check the connection, then try again.' },
  'incomplete-body': { what: 'The transfer broke off.', remedy: 'Check the connection, then try again.' },
  'in-use': { what: 'Something else still needs this.', remedy: 'Delete that first.' },
  'stored-before': { what: 'The server already has a capture with the same files.', remedy: 'Use that capture.' },
  'capture-deleted': { what: 'The photographs of this model were deleted.', remedy: 'Download the model, then use the program relume with the photographs.' },
  'no-confidence': { what: 'This model has no confidence.', remedy: 'Train the capture again with this version of Relume.' },
  'no-subject': { what: 'The photographs of this model do not surround a subject.', remedy: 'Photograph again, and walk around the subject.' },
  'no-materials': { what: 'This model has colours only.', remedy: 'Train the capture again with materials.' },
  'capture-validating': { what: 'The server is still checking this capture.', remedy: 'Try again in a moment.' },
  'no-poses': { what: 'COLMAP could not find out where the photographs were taken.', remedy: 'Photograph again: walk around the subject in small steps, keep the camera still for each photograph, and keep something with texture in view.' },
  'storage-failed': { what: 'The disk of the server failed.', remedy: 'Tell the operator of the server.' },
  internal: { what: 'The server failed.', remedy: 'Try again. If it fails again, send the details to the operator of the server.' },
}

/** The same for uploads whose content cannot be used, by the code of the content. */
const CONTENTS: Record<string, Omit<PageError, 'detail'>> = {
  capture_archive_damaged: { what: 'The file is damaged, or it is not a zip or tar.', remedy: 'Make the archive again and send it again.' },
  capture_archive_unsafe: { what: 'The archive contains paths that lead out of it.', remedy: 'Make the archive again from the folder of the capture.' },
  capture_over_limit: { what: 'The archive is larger than the server accepts.', remedy: 'Leave out photographs, or make them smaller.' },
  capture_layout_unknown: { what: 'The server found no photographs that it can use.', remedy: 'Send the photographs themselves: JPEG, PNG, HEIC, WebP, TIFF or EXR.' },
  capture_image_invalid: { what: 'A photograph is damaged.', remedy: 'Leave it out, or export it again. The details name the file.' },
  capture_too_few_images: { what: 'There are too few photographs.', remedy: 'Take 30 or more, from all sides of the subject.' },
  'timed-out': { what: 'The search for the positions of the photographs took too long.', remedy: 'Send fewer photographs; 50 to 150 are enough for one object.' },
  cancelled: { what: 'The search for the positions of the photographs was stopped.', remedy: 'Send the photographs again.' },
}

/** An error response in the words of the page. */
export function pageErrorOf(problem: Problem | null | undefined, status: number): PageError {
  const kind = problem?.type.split(':').pop() ?? ''
  const said = problem?.detail ?? problem?.title ?? `The server answered ${status}.`
  const known = CONTENTS[problem?.content?.code ?? ''] ?? KINDS[kind]
  const detail = kind === 'internal' && problem ? `${said} (request ${problem.request_id})` : said
  return known ? { ...known, detail } : { what: said }
}

/** Any error in the words of the page. */
export function explain(error: unknown): PageError {
  if (error instanceof Refused) return pageErrorOf(error.problem, error.status)
  if (error instanceof TypeError) return { what: 'The server does not answer.', remedy: 'Check that this device is connected and that the server runs, then try again.' }
  return { what: error instanceof Error ? error.message : String(error) }
}
