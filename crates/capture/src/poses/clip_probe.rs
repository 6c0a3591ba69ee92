//! What ffprobe states about a clip.

/// Facts about the video of a clip.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct ClipFacts {
    /// Duration, seconds.
    pub seconds: Option<f64>,
    /// Mean number of frames per second.
    pub frame_rate: Option<f64>,
    /// Number of frames, if the container states it.
    pub frames: Option<u64>,
    /// Height of the stored frames, pixels.
    pub height: Option<u32>,
    /// Transfer function in the words of ffmpeg, e.g. `bt709`, `arib-std-b67`.
    pub transfer: String,
    /// Colour matrix in the words of ffmpeg, e.g. `bt709`.
    pub matrix: String,
}

/// The transfer function of a high dynamic range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum HighRange {
    /// Hybrid log-gamma (ARIB STD-B67).
    Hlg,
    /// Perceptual quantiser (SMPTE ST 2084).
    Pq,
}

impl ClipFacts {
    /// Arguments of ffprobe before the name of the clip. Its output has the lines that [`Self::read_line`] reads.
    pub(super) const ARGUMENTS: [&'static str; 8] = [
        "-v",
        "error",
        "-select_streams",
        "v:0",
        "-show_entries",
        "format=duration:stream=height,avg_frame_rate,nb_frames,color_space,color_transfer",
        "-of",
        "default=noprint_wrappers=1",
    ];

    /// Reads a line like `height=1080`; other lines are ignored.
    pub(super) fn read_line(&mut self, line: &str) {
        let Some((key, value)) = line.split_once('=') else { return };
        let positive = |value: f64| Some(value).filter(|v| v.is_finite() && *v > 0.0);
        match key {
            "duration" => self.seconds = value.parse().ok().and_then(positive),
            "avg_frame_rate" => {
                self.frame_rate = value.split_once('/').and_then(|(above, below)| {
                    positive(above.parse::<f64>().ok()? / below.parse::<f64>().ok()?)
                });
            }
            "nb_frames" => self.frames = value.parse().ok().filter(|frames| *frames > 0),
            "height" => self.height = value.parse().ok(),
            "color_transfer" => self.transfer = value.to_owned(),
            "color_space" => self.matrix = value.to_owned(),
            _ => {}
        }
    }

    /// The transfer function, if it is one of a high dynamic range.
    pub(super) fn high_range(&self) -> Option<HighRange> {
        match self.transfer.as_str() {
            "arib-std-b67" => Some(HighRange::Hlg),
            "smpte2084" => Some(HighRange::Pq),
            _ => None,
        }
    }

    /// Number of frames of a clip of `seconds`: as stated, or by the mean rate, or at 25 frames per second.
    pub(super) fn frame_count(&self, seconds: f64) -> usize {
        let by_rate = || (seconds * self.frame_rate.unwrap_or(25.0)).round() as u64;
        usize::try_from(self.frames.unwrap_or_else(by_rate)).unwrap_or(usize::MAX).max(1)
    }

    /// The filters of ffmpeg that make a full-range picture with the colour matrix of JPEG (BT.601) and the curve of a
    /// standard dynamic range.
    ///
    /// If `maps_tones`, a high dynamic range is tone-mapped to the primaries of BT.709: the reference white of 203 cd/m² (ITU-R
    /// BT.2408) becomes white, and the range above 70 % of it is compressed. Else its values are taken as those of a standard
    /// dynamic range.
    pub(super) fn colour_filters(&self, maps_tones: bool) -> String {
        match self.high_range().filter(|_| maps_tones) {
            Some(_) => "zscale=transfer=linear:npl=203,format=gbrpf32le,zscale=primaries=bt709,\
                        tonemap=mobius:param=0.7:desat=0,\
                        zscale=transfer=iec61966-2-1:matrix=170m:range=full,format=yuvj420p"
                .to_owned(),
            None => format!(
                "scale=in_color_matrix={}:out_color_matrix=bt601:out_range=full,format=yuvj420p",
                self.scale_matrix()
            ),
        }
    }

    /// The colour matrix in the words of the filter `scale`. Clips without a statement of 720 lines or more are BT.709, by
    /// convention.
    fn scale_matrix(&self) -> &'static str {
        match self.matrix.as_str() {
            "bt709" => "bt709",
            "bt2020nc" | "bt2020c" => "bt2020",
            "smpte240m" => "smpte240m",
            "fcc" => "fcc",
            "bt470bg" | "smpte170m" => "bt601",
            _ if self.height.is_some_and(|height| height >= 720) => "bt709",
            _ => "bt601",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facts(lines: &[&str]) -> ClipFacts {
        let mut facts = ClipFacts::default();
        lines.iter().for_each(|line| facts.read_line(line));
        facts
    }

    #[test]
    fn probe_output_gives_rate_length_and_colours() {
        let hlg = facts(&[
            "height=1920",
            "color_space=bt2020nc",
            "color_transfer=arib-std-b67",
            "avg_frame_rate=30000/1001",
            "nb_frames=N/A",
            "duration=6.006000",
        ]);
        assert_eq!((hlg.seconds, hlg.height), (Some(6.006), Some(1920)));
        assert_eq!((hlg.frame_count(6.006), hlg.high_range()), (180, Some(HighRange::Hlg)));
        let pq = facts(&["color_transfer=smpte2084", "nb_frames=48", "avg_frame_rate=0/0", "duration=N/A"]);
        assert_eq!((pq.frame_count(9.0), pq.high_range(), pq.seconds), (48, Some(HighRange::Pq), None));
        assert!(pq.colour_filters(true).contains("tonemap"));
        assert!(!pq.colour_filters(false).contains("zscale"), "without the filters");
        assert_eq!(facts(&["a video", "color_transfer=bt709"]).high_range(), None);
    }

    #[test]
    fn colour_matrix_is_stated_or_follows_the_height() {
        let matrix = |lines: &[&str]| facts(lines).scale_matrix();
        assert_eq!(matrix(&["color_space=bt709", "height=240"]), "bt709");
        assert_eq!(matrix(&["color_space=unknown", "height=1080"]), "bt709");
        assert_eq!(matrix(&["color_space=unknown", "height=480"]), "bt601");
        assert!(!facts(&["height=1080"]).colour_filters(true).contains("tonemap"));
    }
}
