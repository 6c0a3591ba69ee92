//! Choice of a device: the request, the adapters of the machine, and the selection of one.

use crate::DeviceError;

/// Where to compute.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum DeviceChoice {
    /// The first hardware GPU, or the CPU engine.
    #[default]
    Auto,
    /// The CPU engine.
    Cpu,
    /// A GPU: the first hardware adapter, or the adapter with this number, hardware or software.
    Gpu(Option<usize>),
}

impl std::str::FromStr for DeviceChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "auto" => Ok(Self::Auto),
            "cpu" => Ok(Self::Cpu),
            "gpu" => Ok(Self::Gpu(None)),
            _ => {
                let number = text.strip_prefix("gpu:").and_then(|n| n.parse().ok());
                number.map(|n| Self::Gpu(Some(n))).ok_or_else(|| {
                    format!(
                        "`{text}` is no device: must be `auto`, `cpu`, `gpu` or `gpu:N` (see `relume doctor`)"
                    )
                })
            }
        }
    }
}

impl std::fmt::Display for DeviceChoice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Cpu => f.write_str("cpu"),
            Self::Gpu(None) => f.write_str("gpu"),
            Self::Gpu(Some(n)) => write!(f, "gpu:{n}"),
        }
    }
}

/// Properties of an adapter, known before it is opened.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AdapterReport {
    /// Position among the adapters, the N of `gpu:N`.
    pub index: usize,
    /// Product name.
    pub name: String,
    /// Driver and its version.
    pub driver: String,
    /// Graphics API.
    pub backend: String,
    /// True for a software adapter, which computes on the CPU: correct but slow.
    pub software: bool,
    /// Largest storage binding, bytes.
    pub max_binding: u64,
    /// Largest buffer, bytes.
    pub max_buffer: u64,
    /// Workgroup memory, bytes.
    pub workgroup_memory: u32,
    /// True where the adapter has native float atomics; otherwise kernels use a compare-exchange loop.
    pub float_atomics: bool,
    /// True where times per stage can be measured.
    pub timestamps: bool,
    /// Features that the engine needs and the adapter lacks; empty for a usable adapter.
    pub lacks: Vec<String>,
}

impl AdapterReport {
    /// True when the adapter has everything that the engine needs.
    pub fn usable(&self) -> bool {
        self.lacks.is_empty()
    }
}

/// The index of the adapter that `choice` selects; `None` is the CPU engine.
///
/// # Errors
/// [`DeviceError::Unavailable`] when `choice` requires a GPU and none is usable; the message gives the reason.
pub fn choose_adapter(reports: &[AdapterReport], choice: DeviceChoice) -> Result<Option<usize>, DeviceError> {
    let hardware = || reports.iter().find(|r| !r.software && r.usable()).map(|r| r.index);
    let listed = || {
        let name = |r: &AdapterReport| {
            let kind = if r.software { " (software)" } else { "" };
            let lacks = if r.usable() { String::new() } else { format!(" (lacks {})", r.lacks.join("; ")) };
            format!("gpu:{} {}{kind}{lacks}", r.index, r.name)
        };
        if reports.is_empty() {
            "none".to_owned()
        } else {
            reports.iter().map(name).collect::<Vec<_>>().join(", ")
        }
    };
    let unavailable = |wanted: &str| {
        DeviceError::Unavailable(format!("device: there is no {wanted}; adapters found: {}", listed()))
    };
    match choice {
        DeviceChoice::Cpu => Ok(None),
        // A software adapter is slower than the CPU engine, so only an explicit number selects it.
        DeviceChoice::Auto => Ok(hardware()),
        DeviceChoice::Gpu(None) => {
            hardware().map(Some).ok_or_else(|| unavailable("hardware GPU that can be used"))
        }
        DeviceChoice::Gpu(Some(n)) => match reports.get(n) {
            Some(report) if report.usable() => Ok(Some(n)),
            _ => Err(unavailable(&format!("usable gpu:{n}"))),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(index: usize, software: bool, lacks: &[&str]) -> AdapterReport {
        AdapterReport {
            index,
            name: format!("adapter {index}"),
            driver: String::new(),
            backend: "vulkan".into(),
            software,
            max_binding: 1 << 31,
            max_buffer: 1 << 31,
            workgroup_memory: 48 << 10,
            float_atomics: true,
            timestamps: true,
            lacks: lacks.iter().map(|s| (*s).to_owned()).collect(),
        }
    }

    #[test]
    fn auto_selects_hardware_only_and_an_index_any_usable_adapter() {
        let soft = [report(0, true, &[])];
        assert_eq!(choose_adapter(&soft, DeviceChoice::Auto), Ok(None));
        assert_eq!(choose_adapter(&soft, DeviceChoice::Gpu(Some(0))), Ok(Some(0)));
        let both = [report(0, true, &[]), report(1, false, &["memory: 1"]), report(2, false, &[])];
        assert_eq!(choose_adapter(&both, DeviceChoice::Auto), Ok(Some(2)));
        assert_eq!(choose_adapter(&both, DeviceChoice::Gpu(None)), Ok(Some(2)));
        assert_eq!(choose_adapter(&both, DeviceChoice::Cpu), Ok(None));
    }

    #[test]
    fn unavailable_gpu_is_refused_with_the_list_of_adapters() {
        let DeviceError::Unavailable(text) =
            choose_adapter(&[report(0, true, &[])], DeviceChoice::Gpu(None)).unwrap_err()
        else {
            panic!("wrong kind")
        };
        assert!(text.contains("gpu:0 adapter 0 (software)"), "{text}");
        let lacking = [report(0, false, &["workgroup memory, bytes: 16384"])];
        let text = choose_adapter(&lacking, DeviceChoice::Gpu(Some(0))).unwrap_err().to_string();
        assert!(text.contains("workgroup memory"), "{text}");
        assert!(choose_adapter(&[], DeviceChoice::Gpu(None)).unwrap_err().to_string().contains("none"));
    }

    #[test]
    fn device_choices_parse_and_print_as_documented() {
        for text in ["auto", "cpu", "gpu", "gpu:3"] {
            assert_eq!(text.parse::<DeviceChoice>().unwrap().to_string(), text);
        }
        assert!("gpu:x".parse::<DeviceChoice>().unwrap_err().contains("gpu:N"));
    }
}
