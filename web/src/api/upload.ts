import { type DetailedError, type HttpRequest, Upload } from 'tus-js-client'
import { address, authorization, ask, keyNeeded, post, Refused } from './client'
import type { Capture, Problem } from './types'

/** A file and its path in the capture. */
export interface Dropped {
  path: string
  file: File
}

/** The dropped files: one archive, or the files of a capture. */
export type Selection = { archive: File } | { files: Dropped[]; folder?: string }

/** Receives the bytes sent so far and the total. */
export type OnProgress = (sent: number, total: number) => void

/** Bytes of an upload chunk; at most this much is sent again after a broken connection. */
const PIECE = 8 << 20
const ARCHIVE = /\.(zip|tar|tgz|tar\.gz)$/i
const PHOTOGRAPH = /\.(png|jpe?g|webp|tiff?|exr|heic|heif|hif|avif)$/i
const CLIP = /\.(mp4|mov|m4v|mkv|webm|avi|mts)$/i

export function isPhotograph(path: string): boolean {
  return PHOTOGRAPH.test(path)
}

/** @throws {Error} whose message tells the user what to drop instead. */
export function selection(dropped: Dropped[]): Selection {
  const files = dropped.filter(({ path }) => !path.split('/').some((part) => part.startsWith('.')))
  const only = files[0]
  if (!only) throw new Error('There are no files in it. Choose the folder that has the photographs.')
  if (files.length === 1 && ARCHIVE.test(only.path)) return { archive: only.file }
  if (files.some(({ path }) => ARCHIVE.test(path))) throw new Error('Send one zip by itself, or the photographs of one capture.')
  if (!files.some(({ path }) => isPhotograph(path))) {
    const name = only.path.split('/').pop() ?? ''
    if (files.some(({ path }) => CLIP.test(path))) throw new Error(`${name} is a video. Send photographs instead.`)
    throw new Error(`${files.length === 1 ? `${name} is no photograph and no zip` : 'There is no photograph among these files'}. Send JPEG, PNG, HEIC, WebP, TIFF or EXR files, or a zip of them.`)
  }
  const folder = commonFolder(files)
  return { files: withoutCommonFolder(files), ...(folder ? { folder } : {}) }
}

/** The name of a new capture: that of its archive or folder, else the number of photographs and the day. */
export function nameOf(what: Selection): string {
  if ('archive' in what) return what.archive.name.replace(ARCHIVE, '').slice(0, 200)
  if (what.folder) return what.folder.slice(0, 200)
  const count = what.files.filter(({ path }) => isPhotograph(path)).length
  return `${count} photographs, ${new Date().toLocaleDateString('en', { dateStyle: 'medium' })}`
}

/** The folder that contains all files, if there is one. */
function commonFolder(files: Dropped[]): string | undefined {
  const first = files[0]?.path.split('/')[0]
  return first !== undefined && files.every(({ path }) => path.startsWith(`${first}/`)) ? first : undefined
}

/** Removes the first folder from all paths if they share it. */
function withoutCommonFolder(files: Dropped[]): Dropped[] {
  const first = commonFolder(files)
  if (!first || /^(images|sparse|train)$/.test(first)) return files
  return withoutCommonFolder(files.map(({ path, file }) => ({ path: path.slice(first.length + 1), file })))
}

/** Uploads the dropped files as a capture. */
export async function upload(what: Selection, name: string, onProgress: OnProgress, signal: AbortSignal): Promise<Capture> {
  if ('files' in what) return sendForm(what.files, name, onProgress, signal)
  const id = await sendArchive(what.archive, onProgress, signal)
  return post<Capture>(`v1/captures${query(name)}`, { upload: id }, { Prefer: 'respond-async' })
}

function query(name: string): string {
  return name ? `?name=${encodeURIComponent(name)}` : ''
}

/** Sends an archive in chunks and returns the identifier of the upload. An upload of the same file resumes after a broken connection, even in a new page. */
async function sendArchive(file: File, onProgress: OnProgress, signal: AbortSignal): Promise<string> {
  // If the server requires a key, this request asks the user for it before the upload begins.
  await ask('v1/usage')
  return new Promise((done, failed) => {
    const upload = new Upload(file, {
      endpoint: address('v1/uploads'),
      chunkSize: PIECE,
      retryDelays: [0, 1000, 3000, 5000, 10_000, 20_000],
      removeFingerprintOnSuccess: true,
      metadata: { filename: file.name },
      onBeforeRequest: (request: HttpRequest) => {
        for (const [header, value] of Object.entries(authorization())) request.setHeader(header, value)
      },
      onProgress: (sent, total) => onProgress(sent, total ?? file.size),
      onError: (error) => failed(refused(error)),
      onSuccess: () => done(upload.url?.split('/').pop() ?? ''),
    })
    signal.addEventListener('abort', () => {
      void upload.abort()
      failed(new DOMException('the upload was stopped', 'AbortError'))
    })
    void upload.findPreviousUploads().then(([previous]) => {
      if (previous) upload.resumeFromPreviousUpload(previous)
      upload.start()
    }, failed)
  })
}

/** The answer of the server in an error of the upload, or a lost connection. */
function refused(error: Error | DetailedError): Error {
  const answer = 'originalResponse' in error ? error.originalResponse : null
  if (!answer) return new TypeError(error.message)
  return new Refused(answer.getStatus(), problemIn(answer.getBody()))
}

function problemIn(body: string): Problem | null {
  try {
    return JSON.parse(body) as Problem
  } catch {
    return null
  }
}

/** Sends files as one form. `fetch` reports no upload progress, so this uses XMLHttpRequest. */
async function sendForm(files: Dropped[], name: string, onProgress: OnProgress, signal: AbortSignal): Promise<Capture> {
  await ask('v1/usage')
  const form = new FormData()
  for (const { path, file } of files) form.append('files', file, path)
  const answer = await new Promise<XMLHttpRequest>((done, failed) => {
    const request = new XMLHttpRequest()
    request.open('POST', address(`v1/captures${query(name)}`))
    for (const [header, value] of Object.entries(authorization())) request.setRequestHeader(header, value)
    request.upload.onprogress = ({ loaded, total }) => onProgress(loaded, total)
    request.onload = () => done(request)
    request.onerror = () => failed(new TypeError('the connection broke'))
    signal.addEventListener('abort', () => {
      request.abort()
      failed(new DOMException('the upload was stopped', 'AbortError'))
    })
    request.send(form)
  })
  if (answer.status === 401) await keyNeeded()
  if (answer.status >= 300) throw new Refused(answer.status, problemIn(answer.responseText))
  return JSON.parse(answer.responseText) as Capture
}
