//! The server as a process: a kill during a delivery, its log, and TLS.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;

use relume_api::webhooks::DeliveryState;
use relume_client::Client;
use tempfile::TempDir;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpListener;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::crypto::ring::default_provider;
use tokio_rustls::rustls::pki_types::PrivateKeyDer;

use super::receiver::{Answer, Receiver, for_all, is_signed, newest};
use crate::service_support::trained;

/// A server process that may send to loopback, with its log in a file.
struct Process {
    child: Child,
    client: Client,
}

impl Process {
    fn start(data: &Path, log: &Path, variables: &[(&str, &str)]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
        command.args(["serve", "--listen", "127.0.0.1:0", "--json-logs", "--webhook-allow-private"]);
        command.arg("--data-dir").arg(data.join("data")).env("RUST_LOG", "trace");
        command.envs(variables.iter().copied());
        command.stdout(Stdio::piped()).stderr(File::options().create(true).append(true).open(log).unwrap());
        let mut child = command.spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let base = line.trim().strip_prefix("listening on ").unwrap_or_else(|| panic!("{line:?}"));
        Self { client: Client::new(base, None).unwrap(), child }
    }
}

/// SIGKILL: the server releases nothing.
impl Drop for Process {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn messages_survive_kill_9_and_logs_contain_no_secret() {
    let folder = TempDir::new().unwrap();
    let log = folder.path().join("log");
    let http = [("RELUME_WEBHOOK_ALLOW_HTTP", "true")];
    let mut receiver = Receiver::new().await;
    receiver.answer(&[Answer::Never]);
    let server = Process::start(folder.path(), &log, &http);
    let made = server.client.create_webhook(&for_all(&receiver.url)).await.unwrap();
    let job = trained(&server.client).await;
    let first = receiver.next().await;
    assert_eq!(first.job(), job.id.to_string());
    // The message was sent but not answered, so the server cannot know whether it arrived.
    drop(server);
    let server = Process::start(folder.path(), &log, &http);
    let again = receiver.next().await;
    assert_eq!(again.header("webhook-id"), first.header("webhook-id"));
    assert_eq!(again.body, first.body);
    assert!(is_signed(&made.secret, &again));
    newest(&server.client, &made.webhook.id, |d| d.state == DeliveryState::Delivered).await;
    drop(server);

    let log = std::fs::read_to_string(&log).unwrap();
    assert!(
        log.contains("attempted a webhook delivery") && log.contains(first.header("webhook-id")),
        "the control"
    );
    for secret in [&made.secret[6..], "to=me", first.header("webhook-signature")] {
        assert!(!log.contains(secret), "{secret} is in the log");
    }
}

/// Answers one request over TLS.
async fn answer_over_tls(listener: &TcpListener, tls: &TlsAcceptor) -> Option<String> {
    let (stream, _) = listener.accept().await.unwrap();
    let mut stream = tls.accept(stream).await.ok()?;
    let mut request = Vec::new();
    while !request.ends_with(b"}}}") {
        assert!(stream.read_buf(&mut request).await.unwrap() > 0, "{}", String::from_utf8_lossy(&request));
    }
    stream.write_all(b"HTTP/1.1 204 No Content\r\n\r\n").await.unwrap();
    stream.shutdown().await.ok();
    Some(String::from_utf8(request).unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn messages_are_sent_only_over_tls_with_a_valid_certificate() {
    let folder = TempDir::new().unwrap();
    let certified = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
    let authority = folder.path().join("authority.pem");
    std::fs::write(&authority, certified.cert.pem()).unwrap();
    let key = PrivateKeyDer::try_from(certified.signing_key.serialize_der()).unwrap();
    let config = ServerConfig::builder_with_provider(Arc::new(default_provider()));
    let config = config.with_safe_default_protocol_versions().unwrap().with_no_client_auth();
    let config = config.with_single_cert(vec![certified.cert.der().clone()], key).unwrap();
    let tls = TlsAcceptor::from(Arc::new(config));
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let port = listener.local_addr().unwrap().port();

    let log = folder.path().join("log");
    let trusting = [("SSL_CERT_FILE", authority.to_str().unwrap())];
    let server = Process::start(folder.path(), &log, &trusting);
    let refused = server.client.create_webhook(&for_all("http://localhost/")).await;
    assert!(refused.is_err(), "without TLS only where that is allowed");
    let named = server.client.create_webhook(&for_all(&format!("https://localhost:{port}/"))).await.unwrap();
    trained(&server.client).await;
    let heard = answer_over_tls(&listener, &tls).await.unwrap();
    assert!(heard.contains(&format!("host: localhost:{port}")), "{heard}");
    let id = named.webhook.id;
    let delivered = newest(&server.client, &id, |d| d.state == DeliveryState::Delivered).await;
    assert_eq!(delivered.attempts[0].status, Some(204));
    drop(server);

    // The same receiver, with a certificate authority that this server does not know.
    let other = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
    std::fs::write(&authority, other.cert.pem()).unwrap();
    let server = Process::start(folder.path(), &log, &trusting);
    server.client.replay_delivery(&id, &delivered.id).await.unwrap();
    assert_eq!(answer_over_tls(&listener, &tls).await, None);
    let log = newest(&server.client, &id, |d| d.attempts.len() == 2).await;
    assert!(log.attempts[1].error.as_ref().unwrap().contains("the TLS handshake failed"), "{log:?}");
}
