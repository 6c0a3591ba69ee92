/** Milliseconds after which a released URL is revoked. */
const DELAY = 10_000

/** Revokes the object URL of an image or a download that is no longer needed, after a delay: an element may still load it. */
export function release(url: string | undefined): void {
  if (url) setTimeout(() => URL.revokeObjectURL(url), DELAY)
}
