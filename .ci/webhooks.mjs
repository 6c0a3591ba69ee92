// A webhook receiver: it refuses the first delivery, verifies each message with the package of Standard Webhooks, and checks that
// verification fails for a changed message and for another secret.
import assert from 'node:assert';
import { readFile } from 'node:fs/promises';
import { createServer } from 'node:http';
import { Webhook } from 'standardwebhooks';

const [base, key, capture] = process.argv.slice(2);
const headers = { Authorization: `Bearer ${key}` };

async function ask(path, body, type = 'application/json') {
    const answer = await fetch(base + path, { method: 'POST', headers: { ...headers, 'Content-Type': type }, body });
    const text = await answer.text();
    assert(answer.ok, `${path}: ${answer.status} ${text}`);
    return JSON.parse(text);
}

const received = [];
let heard;
const both = new Promise((resolve) => (heard = resolve));
const receiver = createServer((request, response) => {
    let body = '';
    request.on('data', (piece) => (body += piece));
    request.on('end', () => {
        received.push({ body, headers: request.headers });
        response.writeHead(received.length === 1 ? 503 : 204).end();
        if (received.length === 2) heard();
    });
});
await new Promise((resolve) => receiver.listen(0, '127.0.0.1', resolve));

const url = `http://127.0.0.1:${receiver.address().port}/hook`;
const events = ['job.succeeded', 'job.rejected', 'job.failed', 'job.cancelled'];
const webhook = await ask('/v1/webhooks', JSON.stringify({ url, events }));
const rotated = await ask(`/v1/webhooks/${webhook.id}/rotate-secret`);
assert.notEqual(rotated.secret, webhook.secret);
const { id } = await ask('/v1/captures', await readFile(capture), 'application/zip');
const overrides = { iterations: 20, resolution: 32, max_gaussians: 64 };
const job = await ask('/v1/jobs', JSON.stringify({ capture: id, preset: 'draft', overrides }));
const late = setTimeout(() => { console.error('no webhook arrived within 300 seconds'); process.exit(1); }, 300_000);
await both;
clearTimeout(late);

const former = new Webhook(webhook.secret);
const verifier = new Webhook(rotated.secret);
for (const { body, headers } of received) {
    const message = verifier.verify(body, headers);
    assert.deepEqual(former.verify(body, headers), message, 'the former secret must verify the message during a rotation');
    assert.equal(message.type, 'job.succeeded');
    assert.equal(message.data.job.id, job.id);
    assert.equal(message.data.job.state, 'succeeded');
    assert.throws(() => verifier.verify(body.replace('succeeded', 'cancelled'), headers), 'a changed message must be refused');
    assert.throws(() => new Webhook(`whsec_${'A'.repeat(43)}=`).verify(body, headers), 'another secret must be refused');
}
assert.equal(received[0].headers['webhook-id'], received[1].headers['webhook-id']);
console.log('the server resent a refused webhook, and standardwebhooks verified both deliveries');
receiver.close();
receiver.closeAllConnections();
