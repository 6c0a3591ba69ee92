//! Parses the command line and calls the library.

/// A training step allocates and frees the same large buffers again and again; the system allocator hands
/// each back to the kernel, which then clears its pages again.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    relume::cli::main()
}
