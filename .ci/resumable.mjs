// node resumable.mjs HOST:PORT KEY FILE SEED: uploads FILE with tus-js-client through a proxy that cuts connections.
import assert from 'node:assert/strict'
import { createHash } from 'node:crypto'
import { createReadStream, readFileSync, statSync } from 'node:fs'
import { connect, createServer } from 'node:net'
import { Upload } from 'tus-js-client'

const [address, key, path, seedText] = process.argv.slice(2)
const [host, port] = address.split(':')
const size = statSync(path).size

// Mulberry32, a pseudorandom generator: the same seed gives the same cuts.
let state = Number(seedText)
const random = () => {
  state = (state + 0x6d2b79f5) | 0
  let t = Math.imul(state ^ (state >>> 15), 1 | state)
  t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t
  return ((t ^ (t >>> 14)) >>> 0) / 2 ** 32
}

// The proxy cuts each connection after a random number of bytes to the server. It leaves one in four uncut, so that the upload completes.
let cuts = 0
const proxy = createServer((client) => {
  const server = connect(Number(port), host)
  let left = random() < 0.25 ? Infinity : Math.floor((random() * size) / 3)
  const end = () => {
    client.destroy()
    server.destroy()
  }
  client.on('data', (bytes) => {
    server.write(bytes.subarray(0, Math.min(left, bytes.length)))
    left -= bytes.length
    if (left < 0) {
      cuts += 1
      end()
    }
  })
  server.on('data', (bytes) => client.write(bytes))
  for (const socket of [client, server]) {
    socket.on('error', end)
    socket.on('close', end)
  }
})
await new Promise((ready) => proxy.listen(0, '127.0.0.1', ready))

const headers = { Authorization: `Bearer ${key}` }
const options = {
  endpoint: `http://127.0.0.1:${proxy.address().port}/v1/uploads`,
  headers,
  uploadSize: size,
  metadata: { filename: 'capture.zip' },
  retryDelays: Array(200).fill(20),
}
const upload = await new Promise((done, failed) => {
  let aborts = 0
  const started = new Upload(createReadStream(path), {
    ...options,
    chunkSize: Math.ceil(size / 10),
    onError: failed,
    onSuccess: () => done(started),
    onChunkComplete: () => {
      // The client aborts and resumes up to three times.
      if (aborts < 3 && random() < 0.5) {
        aborts += 1
        started.abort().then(() => started.start())
      }
    },
  })
  started.start()
})
proxy.close()

const id = upload.url.split('/').pop()
const answer = await fetch(`http://${address}/v1/captures`, {
  method: 'POST',
  headers: { ...headers, 'Content-Type': 'application/json' },
  body: JSON.stringify({ upload: id }),
})
const capture = await answer.json()
assert.ok(answer.ok, JSON.stringify(capture))
assert.equal(capture.sha256, createHash('sha256').update(readFileSync(path)).digest('hex'))
assert.ok(cuts > 0, 'control failed: the proxy cut no connection')
console.log(`seed ${seedText}: ${size} bytes, ${cuts} connections cut, the capture equals the file`)
process.exit(0)
