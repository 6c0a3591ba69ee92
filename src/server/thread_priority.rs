//! The priority of threads.

/// Nice value of threads for work that gives way to trainings and frames, of at most 19.
#[cfg(target_os = "linux")]
const NICE: i32 = 10;

/// Lowers the priority of the calling thread, so that it gets the processors only a little while other threads need them. Only Linux
/// has priorities of threads; on other systems this does nothing.
pub(super) fn lower_for_this_thread() {
    #[cfg(target_os = "linux")]
    if let Err(error) = rustix::process::setpriority_process(Some(rustix::thread::gettid()), NICE) {
        tracing::warn!(%error, "the priority of a thread cannot be lowered");
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn only_the_calling_thread_gets_the_low_priority() {
        let nice = || rustix::process::getpriority_process(Some(rustix::thread::gettid())).unwrap();
        let before = nice();
        let inside = std::thread::spawn(move || {
            lower_for_this_thread();
            nice()
        });
        assert_eq!(inside.join().unwrap(), NICE.max(before));
        assert_eq!(nice(), before, "the control");
    }
}
