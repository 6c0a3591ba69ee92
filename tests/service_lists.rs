//! Lists, page by page.

use relume::testing;
use relume_api::JobId;
use reqwest::Method;
use serde_json::{Value, json};

use crate::service_support::{capture_zip, small_job};

#[tokio::test(flavor = "multi_thread")]
async fn paging_while_deleting_returns_every_item_once() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap().id;
    for _ in 0..5 {
        let id = client.create_job(&small_job(&capture, 100_000, 1000), None).await.unwrap().id;
        client.cancel_job(&id).await.unwrap();
    }
    for _ in 0..5 {
        let begin = client.request(Method::POST, "/v1/uploads").unwrap();
        let begin = begin.header("tus-resumable", "1.0.0").header("upload-length", "9");
        assert_eq!(begin.send().await.unwrap().status(), 201);
    }
    for path in ["/v1/jobs", "/v1/uploads"] {
        let (mut met, mut before) = (Vec::new(), String::new());
        loop {
            let page = client.request(Method::GET, &format!("{path}?limit=2{before}")).unwrap();
            let page: Value =
                serde_json::from_str(&page.send().await.unwrap().text().await.unwrap()).unwrap();
            for item in page["items"].as_array().unwrap_or_else(|| panic!("{page}")) {
                let id = item["id"].as_str().unwrap().to_owned();
                let delete = client.request(Method::DELETE, &format!("{path}/{id}")).unwrap();
                let delete = delete.header("tus-resumable", "1.0.0").send().await.unwrap();
                assert_eq!(delete.status(), 204, "{}", delete.text().await.unwrap());
                met.push(id);
            }
            match page["next"].as_str() {
                Some(next) => before = format!("&before={next}"),
                None => break,
            }
        }
        met.sort_unstable();
        met.dedup();
        assert_eq!(met.len(), 5, "{path}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn lists_page_from_the_newest_to_the_oldest() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap().id;
    let mut made = Vec::new();
    for _ in 0..5 {
        made.push(client.create_job(&small_job(&capture, 100_000, 1000), None).await.unwrap().id);
    }
    let (mut seen, mut before) = (Vec::new(), String::new());
    loop {
        let request = client.request(Method::GET, &format!("/v1/jobs?limit=2{before}")).unwrap();
        let page: Value = serde_json::from_str(&request.send().await.unwrap().text().await.unwrap()).unwrap();
        seen.extend(page["items"].as_array().unwrap().iter().map(|j| JobId::from(j["id"].as_str().unwrap())));
        match page["next"].as_str() {
            Some(next) => before = format!("&before={next}"),
            None => break,
        }
    }
    made.reverse();
    assert_eq!(seen, made);
    let list = async |query: &str| {
        let request = client.request(Method::GET, &format!("/v1/jobs?{query}")).unwrap();
        serde_json::from_str::<Value>(&request.send().await.unwrap().text().await.unwrap()).unwrap()
    };
    assert!(list("limit=4").await["next"].is_string(), "one more comes");
    assert!(list("limit=5").await["next"].is_null(), "a page that is exactly full and the last one");
    for path in ["jobs", "captures", "models", "environments"] {
        let request = client.request(Method::GET, &format!("/v1/{path}?before=nothing")).unwrap();
        let answer = request.send().await.unwrap();
        assert_eq!(answer.status(), 422, "{path}");
        let problem: Value = serde_json::from_str(&answer.text().await.unwrap()).unwrap();
        assert_eq!(problem["errors"][0]["pointer"], "query/before", "{path}");
    }
    for id in &made {
        client.cancel_job(id).await.unwrap();
    }
    let request = client.request(Method::GET, "/v1/jobs?state=succeeded").unwrap();
    let none: Value = serde_json::from_str(&request.send().await.unwrap().text().await.unwrap()).unwrap();
    assert_eq!(none["items"], json!([]));
}
