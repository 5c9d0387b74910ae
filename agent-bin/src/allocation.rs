//! How the system's allocator keeps the memory that a program gives back.

/// Bytes that are kept rather than given back to the system: as much as the images and pyramids of some frames, which
/// come and go with every frame.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const KEPT: i32 = 16 << 20;
/// Blocks from this size on come from the system one by one, and go back to it.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const SINGLE: i32 = 4 << 20;

/// Tells the C library to take no more heaps than there are cores, where it would take eight for each, and to keep the
/// memory of a few frames. To be called before there are threads. Measured on two cores: a tenth less memory, and half the
/// time in the system.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
pub fn tune() {
    let cores = std::thread::available_parallelism().map_or(2, std::num::NonZero::get);
    let heaps = i32::try_from(cores).unwrap_or(i32::MAX);
    for (what, value) in
        [(libc::M_ARENA_MAX, heaps), (libc::M_TRIM_THRESHOLD, KEPT), (libc::M_MMAP_THRESHOLD, SINGLE)]
    {
        // SAFETY: sets a parameter of the allocator, before there are threads. One that is refused stays as it was.
        let _ = unsafe { libc::mallopt(what, value) };
    }
}

/// Other C libraries are left as they are.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub fn tune() {}
