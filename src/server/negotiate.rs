//! Content negotiation of the image format.

use axum::http::{HeaderMap, StatusCode, header};

use crate::server::problem::Problem;
use relume_spec::rendering::FrameFormat;

/// The format that `Accept` prefers; PNG without this header.
///
/// # Errors
/// 406 if no supported format is accepted.
pub(super) fn frame_format(headers: &HeaderMap) -> Result<FrameFormat, Problem> {
    let Some(accept) = headers.get(header::ACCEPT) else { return Ok(FrameFormat::Png) };
    let mut ranges: Vec<(f32, &str)> =
        accept.to_str().unwrap_or_default().split(',').map(weighted).filter(|(q, _)| *q > 0.0).collect();
    // The sort is stable, so the order of the client decides among equal weights.
    ranges.sort_by(|a, b| b.0.total_cmp(&a.0));
    ranges.iter().find_map(|(_, range)| matching(range)).ok_or_else(|| {
        Problem::new(StatusCode::NOT_ACCEPTABLE, "not-acceptable", "No acceptable representation")
            .detail("image/png, image/jpeg and image/x-exr are available")
    })
}

fn matching(range: &str) -> Option<FrameFormat> {
    match range {
        "*/*" | "image/*" => Some(FrameFormat::Png),
        _ => FrameFormat::ALL.into_iter().find(|f| f.media_type() == range),
    }
}

/// An entry of `Accept` with its weight.
fn weighted(entry: &str) -> (f32, &str) {
    let mut parts = entry.split(';').map(str::trim);
    let range = parts.next().unwrap_or_default();
    let q = parts.find_map(|p| p.strip_prefix("q=")).map_or(Some(1.0), |q| q.parse().ok());
    (q.unwrap_or(0.0), range)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn accept(value: &str) -> Option<FrameFormat> {
        let headers = HeaderMap::from_iter([(header::ACCEPT, value.parse().unwrap())]);
        frame_format(&headers).ok()
    }

    #[test]
    fn accept_header_selects_the_preferred_format() {
        assert_eq!(accept("image/jpeg;q=0.5, image/x-exr"), Some(FrameFormat::Exr));
        assert_eq!(accept("text/html, image/*;q=0.8"), Some(FrameFormat::Png));
        assert_eq!(accept("image/webp, image/jpeg, image/png"), Some(FrameFormat::Jpeg));
        assert_eq!(accept("text/html"), None);
        assert_eq!(accept("image/png;q=0"), None);
    }
}
