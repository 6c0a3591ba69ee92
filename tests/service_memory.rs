//! Requests that need much memory: the memory budget delays or refuses them, and they leave no files.

use relume::testing;
use reqwest::Method;
use serde_json::{Value, json};
use tempfile::TempDir;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use crate::service_support::{files_under, trained};

/// A Radiance header of the largest map, without texels.
const LARGEST_MAP: &str = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8192 +X 16384\n";

async fn problem(answer: reqwest::Response) -> Value {
    assert_eq!(answer.headers()["content-type"], "application/problem+json");
    serde_json::from_str(&answer.text().await.unwrap()).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn requests_over_the_memory_limit_answer_413_and_others_succeed() {
    let server = testing::spawn_with(TempDir::new().unwrap(), |c| c.limits.memory_bytes = 64 << 20);
    let server = server.await.unwrap();
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let before = files_under(server.data_dir());
    let render = format!("/v1/models/{model}/render");
    let frame = |side: u32, outputs: &[&str]| {
        let look = json!({ "eye": [0, -3, 1], "target": [0, 0, 0], "fov_y_deg": 40 });
        let request =
            json!({ "camera": { "look_at": look }, "width": side, "height": side, "outputs": outputs });
        client.request(Method::POST, &render).unwrap().header("accept", "image/x-exr").json(&request)
    };
    let all = ["rgb", "albedo", "normal", "depth", "diffuse", "specular"];
    let refused = [
        ("frame", frame(4096, &all).send().await.unwrap()),
        (
            "map",
            client
                .request(Method::POST, "/v1/environments")
                .unwrap()
                .header("content-type", "image/vnd.radiance")
                .body(LARGEST_MAP)
                .send()
                .await
                .unwrap(),
        ),
    ];
    for (what, answer) in refused {
        assert_eq!(answer.status(), 413, "{what}");
        let problem = problem(answer).await;
        assert_eq!(problem["type"], "urn:relume:problem:needs-memory", "{what}");
        assert!(problem["detail"].as_str().unwrap().contains("MiB"), "{what}: {problem}");
    }
    // The body is refused before it is sent.
    let base = client.base().to_string();
    let mut stream =
        TcpStream::connect(base.trim_start_matches("http://").trim_end_matches('/')).await.unwrap();
    let head = format!(
        "POST {render} HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: {}\r\n\r\n",
        30 << 20
    );
    stream.write_all(head.as_bytes()).await.unwrap();
    let mut answer = String::new();
    while !answer.contains("needs-memory") {
        let mut piece = [0; 1024];
        let read = stream.read(&mut piece).await.unwrap();
        assert!(read > 0, "the connection ended after {answer:?}");
        answer += &String::from_utf8_lossy(&piece[..read]);
    }
    assert!(answer.starts_with("HTTP/1.1 413"), "{answer}");
    assert_eq!(frame(64, &all).send().await.unwrap().status(), 200, "the control: a small frame is made");
    let thumbnail = client.request(Method::GET, &format!("/v1/models/{model}/thumbnail?size=64")).unwrap();
    assert_eq!(thumbnail.send().await.unwrap().status(), 200);
    // The checkpoint of the ended job may have been removed in the meantime.
    let is_new = |file: &(String, u64)| !file.0.starts_with("cache/") && !before.contains(file);
    let left: Vec<_> = files_under(server.data_dir()).into_iter().filter(is_new).collect();
    assert!(left.is_empty(), "left of them: {left:?}");
}
