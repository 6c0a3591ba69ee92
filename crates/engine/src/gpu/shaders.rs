//! The shaders that the build script expanded and validated: text, bindings and struct layouts.

/// A compute shader with one entry point `main`.
#[derive(Debug)]
pub struct Kernel {
    /// Name of the permutation.
    pub name: &'static str,
    /// WGSL text.
    pub source: &'static str,
    /// WGSL text for devices without float atomics, where it differs.
    pub fallback: Option<&'static str>,
    /// Workgroup size.
    pub workgroup: [u32; 3],
    /// Kinds of bindings 0, 1, 2, ... of group 0.
    pub bindings: &'static [BindingKind],
    /// Layouts of its named structs.
    pub structs: &'static [StructLayout],
}

/// Kind of a binding.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BindingKind {
    /// A uniform struct.
    Uniform,
    /// A read-only storage buffer.
    Read,
    /// A read-write storage buffer.
    Write,
}

/// Size and member offsets of a WGSL struct, bytes.
#[derive(Debug)]
pub struct StructLayout {
    /// Its name.
    pub name: &'static str,
    /// Its size.
    pub size: usize,
    /// Member names and offsets.
    pub members: &'static [(&'static str, usize)],
}

impl Kernel {
    /// The layout of struct `name`, if this kernel has it.
    pub fn layout(&self, name: &str) -> Option<&'static StructLayout> {
        self.structs.iter().find(|s| s.name == name)
    }
}

include!(concat!(env!("OUT_DIR"), "/shaders.rs"));

/// Asserts that a host struct has the size and the member offsets of its WGSL counterpart.
#[cfg(test)]
macro_rules! assert_layout {
    ($host:ty as $name:literal in $shader:expr; $($member:ident),+ $(,)?) => {
        let layout = $shader.layout($name).unwrap_or_else(|| panic!("no struct {}", $name));
        assert_eq!(layout.size, size_of::<$host>(), "size of {}", $name);
        let host = [$((stringify!($member), std::mem::offset_of!($host, $member))),+];
        assert_eq!(layout.members, host, "members of {}", $name);
    };
}
#[cfg(test)]
pub(crate) use assert_layout;

#[cfg(test)]
mod tests {
    /// The viewer is built without this crate, so it has a copy of its shaders. With RELUME_ACCEPT set the test renews the copy.
    #[test]
    fn viewer_shaders_match_this_engine() {
        let made = include_str!(concat!(env!("OUT_DIR"), "/viewer_shaders.json"));
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../web/src/viewer/shaders.json");
        if std::env::var_os("RELUME_ACCEPT").is_some() {
            std::fs::write(path, made).unwrap();
        }
        let copied = std::fs::read_to_string(path).unwrap();
        assert!(
            made == copied,
            "run RELUME_ACCEPT=1 cargo test --release -p relume-engine --lib viewer_shaders_match, then npm run build in web/"
        );
    }
}
