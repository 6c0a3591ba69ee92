import type { Dropped } from './api/upload'

/** All files of a drop, including those in folders. */
export async function filesOf(transfer: DataTransfer): Promise<Dropped[]> {
  // The browser clears the entries after the event, so read them before the first await.
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry()).filter((entry) => entry !== null)
  if (!entries.length) return filesIn(transfer.files)
  return (await Promise.all(entries.map(walk))).flat()
}

/** The files of an input, with their paths in the selected folder. */
export function filesIn(files: FileList | null): Dropped[] {
  return [...(files ?? [])].map((file) => ({ path: file.webkitRelativePath || file.name, file }))
}

async function walk(entry: FileSystemEntry): Promise<Dropped[]> {
  if (isFile(entry)) {
    const file = await new Promise<File>((done, failed) => entry.file(done, failed))
    return [{ path: entry.fullPath.replace(/^\//, ''), file }]
  }
  const reader = (entry as FileSystemDirectoryEntry).createReader()
  const found: Dropped[] = []
  // `readEntries` returns at most 100 entries per call.
  for (;;) {
    const some = await new Promise<FileSystemEntry[]>((done, failed) => reader.readEntries(done, failed))
    if (!some.length) return found
    found.push(...(await Promise.all(some.map(walk))).flat())
  }
}

function isFile(entry: FileSystemEntry): entry is FileSystemFileEntry {
  return entry.isFile
}
