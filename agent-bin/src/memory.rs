//! How freed memory goes back to the system.

/// Blocks of this size and more, bytes, are the system's again as soon as they are freed.
///
/// Left to itself, the C library raises this limit with every large block that is freed, up to 32 MB: the planes of
/// feature detection and the sums of optimisations then leave holes in the heaps of many threads, which on a hand-held
/// minute are a third of all memory. Pages that come anew each time cost time, so blocks of the size of one image are
/// below it.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const OWN_MAPPING: i32 = 1 << 20;

/// Sets it. Call it before there are threads.
pub fn give_back_large_blocks() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: it sets one number of the allocator, and no other thread allocates yet.
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, OWN_MAPPING);
    }
}
