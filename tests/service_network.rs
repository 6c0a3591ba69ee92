//! Slow, silent or many clients: others are still answered, and connections are not held for long.

use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use relume::server::{ConnectionLimits, raise_file_limit};
use relume::testing::{self, TestServer};
use relume_client::Client;
use tempfile::TempDir;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use crate::service_support::{capture_zip, files_under, trained};

/// Much longer than any operation of these tests takes.
const LONG: Duration = Duration::from_secs(60);

/// The part of a request that a slow client sends before it stops.
const HALF_SENT: [&str; 4] = [
    "",
    "GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: ",
    "POST /v1/jobs HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\nContent-Length: 1000\r\n\r\n{",
    "POST /v1/models/x/render HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\nContent-Length: 9\r\n\r\n",
];

async fn server_with(change: impl FnOnce(&mut ConnectionLimits)) -> TestServer {
    testing::spawn_with(TempDir::new().unwrap(), |c| change(&mut c.connections)).await.unwrap()
}

fn address(client: &Client) -> SocketAddr {
    let base = client.base().to_string();
    base.trim_start_matches("http://").trim_end_matches('/').parse().unwrap()
}

/// Opens a connection and sends part of a request.
async fn half_sent(address: SocketAddr, text: &str) -> TcpStream {
    let mut stream = TcpStream::connect(address).await.unwrap();
    stream.write_all(text.as_bytes()).await.unwrap();
    stream
}

/// Everything the server sends until it closes; a connection that is reset counts as closed.
async fn until_closed(stream: &mut TcpStream) -> String {
    let mut answer = Vec::new();
    let reading = stream.read_to_end(&mut answer);
    let _ = tokio::time::timeout(LONG, reading).await.expect("the server closes the connection");
    String::from_utf8(answer).unwrap()
}

async fn is_healthy(client: &Client) -> bool {
    let request = client.request(reqwest::Method::GET, "/healthz").unwrap().timeout(LONG);
    request.send().await.is_ok_and(|answer| answer.status().is_success())
}

/// A server that refuses every upload before it reads it.
async fn refusing_server() -> TestServer {
    testing::spawn_with(TempDir::new().unwrap(), |c| c.limits.disk_bytes = Some(1)).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_sends_its_whole_body_first_gets_the_refusal() {
    const BYTES: usize = 24 << 20;
    let server = refusing_server().await;
    let head = format!(
        "POST /v1/captures HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/zip\r\nContent-Length: {BYTES}\r\n\r\n"
    );
    for _ in 0..5 {
        let mut stream = half_sent(address(server.client()), &head).await;
        stream.write_all(&vec![0; BYTES]).await.unwrap();
        let answer = until_closed(&mut stream).await;
        assert!(answer.starts_with("HTTP/1.1 507"), "{answer}");
        assert!(answer.contains("connection: close\r\n") && answer.contains("storage-limit"), "{answer}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn after_a_refused_upload_the_next_request_succeeds() {
    let server = refusing_server().await;
    for bytes in [1000, 300_000, 3_000_000].repeat(10) {
        let pieces = futures::stream::iter([Ok::<_, std::io::Error>(vec![0; bytes])]);
        let request = server.client().request(reqwest::Method::POST, "/v1/captures").unwrap();
        let request = request.header("content-type", "application/zip");
        // A streamed body cannot be sent twice, so the client cannot hide a fault of the server by a retry.
        let answer = request.body(reqwest::Body::wrap_stream(pieces)).send().await.unwrap();
        assert_eq!(answer.status(), 507);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn two_thousand_partial_requests_do_not_block_other_clients() {
    raise_file_limit(5000);
    let (files, _) = rlimit::getrlimit(rlimit::Resource::NOFILE).unwrap();
    // Both ends of each connection are open files of this process.
    let count = usize::try_from(files / 2).unwrap().saturating_sub(300).min(2000);
    let server = testing::spawn().await.unwrap();
    let model = trained(server.client()).await.model.unwrap();
    let mut slow = Vec::new();
    for i in 0..count {
        slow.push(half_sent(address(server.client()), HALF_SENT[i % HALF_SENT.len()]).await);
    }
    assert!(is_healthy(server.client()).await);
    let thumbnail = server.client().thumbnail(&model, "env=studio&size=32");
    tokio::time::timeout(LONG, thumbnail).await.unwrap().unwrap();
    drop(slow);
    server.stop().await.unwrap();
}

/// A server in a separate process, which may open `files` files.
fn serve_with_files(folder: &Path, files: u32) -> (Child, Client) {
    let script = format!("ulimit -n {files} && exec \"$0\" serve --listen 127.0.0.1:0 --data-dir data");
    let mut server = Command::new("sh")
        .args(["-c", &script, env!("CARGO_BIN_EXE_relume")])
        .current_dir(folder)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(server.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let base = line.trim().strip_prefix("listening on ").unwrap();
    (server, Client::new(base, None).unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn few_file_descriptors_are_not_exhausted_by_partial_requests() {
    raise_file_limit(5000);
    let folder = TempDir::new().unwrap();
    let (mut server, client) = serve_with_files(folder.path(), 400);
    let mut slow = Vec::new();
    for i in 0..600 {
        slow.push(half_sent(address(&client), HALF_SENT[i % 2]).await);
    }
    let healthy = is_healthy(&client).await;
    server.kill().unwrap();
    server.wait().unwrap();
    assert!(healthy);
}

#[tokio::test(flavor = "multi_thread")]
async fn at_the_connection_limit_only_idle_connections_are_closed() {
    let server = server_with(|limits| limits.connections = 20).await;
    let capture = server.client().upload_capture_bytes(capture_zip()).await.unwrap();
    let mut first = half_sent(address(server.client()), HALF_SENT[1]).await;
    let mut others = Vec::new();
    for _ in 0..40 {
        others.push(half_sent(address(server.client()), HALF_SENT[1]).await);
    }
    assert_eq!(until_closed(&mut first).await, "", "the one that waited longest is closed");
    // A new client: the idle connection of the previous one was also closed, which it may not have noticed
    // yet.
    let client = Client::new(server.client().base().as_str(), None).unwrap();
    assert!(is_healthy(&client).await);
    assert_eq!(client.captures().await.unwrap().items[0].id, capture.id);

    // Uploads that the server has begun to read.
    let upload = "POST /v1/captures HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/zip\r\n\
                  Content-Length: 1000\r\nExpect: 100-continue\r\n\r\n";
    let mut answered = Vec::new();
    for _ in 0..20 {
        let mut stream = half_sent(address(server.client()), upload).await;
        let mut begin = [0; 12];
        stream.read_exact(&mut begin).await.unwrap();
        assert_eq!(&begin, b"HTTP/1.1 100");
        answered.push(stream);
    }
    let mut more = half_sent(address(server.client()), "").await;
    let refusal = until_closed(&mut more).await;
    assert!(refusal.starts_with("HTTP/1.1 503") && refusal.contains("urn:relume:problem:busy"), "{refusal}");
    drop((answered, others));
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn partial_heads_time_out_before_idle_connections() {
    let server = server_with(|limits| limits.head = Duration::from_millis(200)).await;
    let mut quiet = half_sent(address(server.client()), "").await;
    let mut half = half_sent(address(server.client()), HALF_SENT[1]).await;
    assert_eq!(until_closed(&mut half).await, "");
    quiet.write_all(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").await.unwrap();
    assert!(until_closed(&mut quiet).await.starts_with("HTTP/1.1 200"));

    let server = server_with(|limits| limits.idle = Duration::from_millis(200)).await;
    let mut quiet = half_sent(address(server.client()), "").await;
    assert_eq!(until_closed(&mut quiet).await, "");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stalled_body_answers_408_and_leaves_nothing() {
    let server = server_with(|limits| limits.body = Duration::from_millis(300)).await;
    let form = "Content-Type: multipart/form-data; boundary=x\r\nContent-Length: 5000\r\n\r\n--x\r\n\
                Content-Disposition: form-data; name=\"archive\"; filename=\"a.zip\"\r\n\r\nPK";
    let bodies = [
        ("jobs", "Content-Type: application/json\r\nContent-Length: 1000\r\n\r\n{"),
        ("captures", "Content-Type: application/zip\r\nContent-Length: 1000\r\n\r\nPK"),
        ("captures", form),
        ("environments", "Content-Type: image/x-exr\r\nContent-Length: 1000\r\n\r\nv/1"),
    ];
    for (path, body) in bodies {
        let text = format!("POST /v1/{path} HTTP/1.1\r\nHost: localhost\r\n{body}");
        let mut stream = half_sent(address(server.client()), &text).await;
        let answer = until_closed(&mut stream).await;
        assert!(answer.starts_with("HTTP/1.1 408"), "{path}: {answer}");
        assert!(answer.contains("urn:relume:problem:timeout"), "{path}: {answer}");
    }
    assert!(files_under(server.data_dir()).is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_slow_but_steady_upload_does_not_time_out() {
    let limit = Duration::from_millis(500);
    let server = server_with(|limits| limits.body = limit).await;
    let zip = capture_zip();
    let head = format!(
        "POST /v1/captures HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\
         Content-Type: application/zip\r\nContent-Length: {}\r\n\r\n",
        zip.len()
    );
    let mut stream = half_sent(address(server.client()), &head).await;
    let mut pace = tokio::time::interval(limit / 5);
    for piece in zip.chunks(zip.len().div_ceil(10)) {
        pace.tick().await;
        stream.write_all(piece).await.unwrap();
    }
    assert!(until_closed(&mut stream).await.starts_with("HTTP/1.1 201"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_does_not_read_its_response_is_disconnected() {
    let server = server_with(|limits| limits.write = Duration::from_millis(200)).await;
    let request = "GET /v1/openapi.json HTTP/1.1\r\nHost: localhost\r\n\r\n";
    let mut stream = half_sent(address(server.client()), &request.repeat(1000)).await;
    let let_go = async {
        // Nothing is read, so only a failed write shows that the server has closed.
        while stream.write_all(request.as_bytes()).await.is_ok() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    tokio::time::timeout(LONG, let_go).await.expect("the server closes the connection");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_shutdown_does_not_wait_for_partial_requests() {
    let server = testing::spawn().await.unwrap();
    let mut slow = half_sent(address(server.client()), HALF_SENT[1]).await;
    assert!(is_healthy(server.client()).await);
    // Shorter than the drain timeout of connections.
    tokio::time::timeout(Duration::from_secs(15), server.stop()).await.unwrap().unwrap();
    assert_eq!(until_closed(&mut slow).await, "");
}
