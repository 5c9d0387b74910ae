//! Keyframes of long runs on the disk: what is more than memory is given to files that have no name, which the system
//! reads and writes page by page as it is looked at, and forgets when the program ends.

use geometry::{Swap, Swapped};
use memmap2::{MmapOptions, MmapRaw, UncheckedAdvice};
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Bytes of keyframes that stay in memory: some hundred of 640 × 480 pixels.
const IN_MEMORY: u64 = 128 << 20;
/// Bytes of a file.
const FILE: usize = 32 << 20;
/// Bytes, at a multiple of as many, that the system maps at once where one of them is looked at: Linux takes sixteen pages.
const AROUND: usize = 64 << 10;
/// Bytes that are left free on the disk, for the results.
const FREE: u64 = 1 << 30;

/// Files that keep what is too much for memory.
pub struct SwapFiles {
    folder: PathBuf,
    /// Bytes that are still left in memory.
    spare: AtomicU64,
    open: Mutex<Option<Open>>,
    /// Bytes of all files there are.
    on_disk: Arc<AtomicU64>,
}

impl fmt::Debug for SwapFiles {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.debug_struct("SwapFiles").field("folder", &self.folder).finish_non_exhaustive()
    }
}

/// A file without a name, in the memory of the program.
struct SwapFile {
    pages: MmapRaw,
    on_disk: Arc<AtomicU64>,
}

impl Drop for SwapFile {
    fn drop(&mut self) {
        self.on_disk.fetch_sub(self.pages.len() as u64, Ordering::Relaxed);
    }
}

/// The file that is being filled.
struct Open {
    file: Arc<SwapFile>,
    used: usize,
}

impl SwapFiles {
    /// Files on the disk of `folder`, for what is more than 128 MiB in all.
    pub fn new(folder: PathBuf) -> Self {
        Self::beyond(folder, IN_MEMORY)
    }

    /// The same for one of so many that are used at a time, and are in memory together what one alone is.
    pub fn of_one_in(folder: PathBuf, count: usize) -> Self {
        Self::beyond(folder, IN_MEMORY / count.max(1) as u64)
    }

    /// The same, for what is more than `in_memory` bytes.
    pub fn beyond(folder: PathBuf, in_memory: u64) -> Self {
        let (open, on_disk) = Default::default();
        Self { folder, spare: in_memory.into(), open, on_disk }
    }

    /// Bytes that the files take on the disk: they are in no folder's listing.
    pub fn on_disk(&self) -> u64 {
        self.on_disk.load(Ordering::Relaxed)
    }

    /// A file without a name. All its room is taken at once: a disk that is full later would end the program when its
    /// pages are looked at.
    fn begin(&self, size: usize) -> io::Result<Open> {
        if free_bytes(&self.folder).is_none_or(|free| free < FREE + size as u64) {
            return Err(io::ErrorKind::StorageFull.into());
        }
        let file = tempfile::tempfile_in(&self.folder)?;
        rustix::fs::fallocate(&file, rustix::fs::FallocateFlags::empty(), 0, size as u64)?;
        let pages = MmapOptions::new().len(size).map_raw(&file)?;
        self.on_disk.fetch_add(size as u64, Ordering::Relaxed);
        Ok(Open { file: Arc::new(SwapFile { pages, on_disk: Arc::clone(&self.on_disk) }), used: 0 })
    }
}

impl Swap for SwapFiles {
    fn keep(&self, bytes: &[u8]) -> Option<Arc<dyn Swapped>> {
        let size = bytes.len() as u64;
        let take = |spare: u64| spare.checked_sub(size);
        if size == 0 || self.spare.fetch_update(Ordering::Relaxed, Ordering::Relaxed, take).is_ok() {
            return None;
        }
        // From page to page, so that one piece can rest while the next does not.
        let room = bytes.len().next_multiple_of(rustix::param::page_size());
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        if open.as_ref().is_none_or(|open| open.used + room > open.file.pages.len()) {
            *open = Some(self.begin(room.max(FILE)).ok()?);
        }
        let open = open.as_mut()?;
        let piece = Piece { file: Arc::clone(&open.file), start: open.used, len: bytes.len() };
        // Safety: within the file, and nobody else's part of it.
        unsafe {
            piece
                .file
                .pages
                .as_mut_ptr()
                .add(piece.start)
                .copy_from_nonoverlapping(bytes.as_ptr(), bytes.len())
        };
        open.used += room;
        Some(Arc::new(piece))
    }
}

/// A part of a file, which lives as long as its parts.
struct Piece {
    file: Arc<SwapFile>,
    start: usize,
    len: usize,
}

impl Piece {
    /// Where what came into memory with the piece is in the file: its start and its length.
    fn around(&self) -> (usize, usize) {
        let (file, size) = (self.file.pages.as_ptr() as usize, self.file.pages.len());
        let start = (file + self.start) / AROUND * AROUND;
        let end = (file + self.start + self.len).next_multiple_of(AROUND);
        let start = start.saturating_sub(file);
        (start, (end - file).min(size) - start)
    }
}

// Safety: what was written before anybody got the piece is not written again; the mapping stays where it is.
unsafe impl Swapped for Piece {
    fn bytes(&self) -> &[u8] {
        // Safety: within the mapping, and written once.
        unsafe { std::slice::from_raw_parts(self.file.pages.as_ptr().add(self.start), self.len) }
    }

    fn rest(&self) {
        let (start, len) = self.around();
        // Safety: a file's pages are not lost with the memory they take, and neighbours that are in use are read again. Whether it
        // is given back is the system's affair.
        let _ = unsafe { self.file.pages.unchecked_advise_range(UncheckedAdvice::DontNeed, start, len) };
    }
}

/// Bytes of a file system that a program may still write; `None` where that is not known.
pub fn free_bytes(folder: &Path) -> Option<u64> {
    let about = rustix::fs::statvfs(folder).ok()?;
    about.f_bavail.checked_mul(about.f_frsize)
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{Buffer, GrayImage};
    use loopbox_tests::{Recording, World, trajectory};
    use place_recog::ThumbnailIndex;
    use slam_direct::{Agent, Frame, Params};

    #[test]
    fn what_is_more_than_memory_is_swapped_to_files_and_reads_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let swap = SwapFiles::beyond(folder.path().to_owned(), 400);
        let values: Buffer<f32> = (0..100).map(|i| i as f32).collect();
        assert!(values.swapped_out(&swap).is_none(), "it fits into memory");
        let many: Vec<Buffer<f32>> =
            (0..3).map(|k| (0..3_000_000).map(|i| (i * 7 + k) as f32).collect()).collect();
        let out: Vec<Buffer<f32>> = many.iter().map(|values| values.swapped_out(&swap).unwrap()).collect();
        out.iter().for_each(Buffer::rest);
        assert!(swap.on_disk() >= 3 * 12_000_000);
        assert!(out == many);
        drop(out);
        // The file that is being filled stays.
        assert!(swap.on_disk() <= FILE as u64);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "no file is left behind");
    }

    /// What is in memory of the mapping that these bytes are in, kB.
    #[cfg(target_os = "linux")]
    fn resident(bytes: &[u8]) -> usize {
        let smaps = std::fs::read_to_string("/proc/self/smaps").unwrap();
        let at = bytes.as_ptr() as usize;
        let holds = |line: &&str| {
            let range = line.split(' ').next().and_then(|range| range.split_once('-'));
            let address = |text| usize::from_str_radix(text, 16);
            range.is_some_and(|(start, end)| {
                matches!((address(start), address(end)), (Ok(start), Ok(end)) if (start..end).contains(&at))
            })
        };
        let rss = smaps.lines().skip_while(|line| !holds(line)).find_map(|line| line.strip_prefix("Rss:"));
        rss.unwrap().trim().trim_end_matches(" kB").parse().unwrap()
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn what_comes_into_memory_with_a_small_piece_rests_with_it() {
        let folder = tempfile::tempdir().unwrap();
        let swap = SwapFiles::beyond(folder.path().to_owned(), 0);
        let small = |k: u8| Buffer::from(vec![k; 3000]).swapped_out(&swap).unwrap();
        let pieces: Vec<Buffer<u8>> = (0..50).map(small).collect();
        pieces.iter().for_each(Buffer::rest);
        assert_eq!(resident(&pieces[0]), 0);
        for (k, piece) in pieces.iter().enumerate() {
            assert!(piece.iter().all(|&byte| usize::from(byte) == k));
            assert!(resident(piece) >= 4);
            piece.rest();
            assert_eq!(resident(piece), 0, "piece {k} leaves its neighbours in memory");
        }
    }

    #[test]
    fn a_map_is_the_same_with_its_keyframes_on_the_disk() {
        let recording =
            Recording::render(&World::yard(3), Recording::SMALL_CAMERA, &trajectory::sideways(70, 3.0), 30.0);
        let folder = tempfile::tempdir().unwrap();
        let mapped = |swap: Option<SwapFiles>| {
            let params = Params::default();
            let mut agent =
                Agent::new(recording.camera, Box::new(ThumbnailIndex::default()), params).unwrap();
            if let Some(swap) = swap {
                agent.swap_to(Arc::new(swap));
            }
            for (index, shot) in (0..).zip(&recording.shots) {
                let image = GrayImage::clone(&shot.image);
                let frame = Frame { image, timestamp: shot.timestamp, index, color: None };
                agent.process(frame).unwrap();
            }
            agent.finish();
            agent.into_map()
        };
        let swapped = mapped(Some(SwapFiles::beyond(folder.path().to_owned(), 0)));
        assert!(swapped.keyframes.len() > 5);
        swapped.rest();
        assert!(swapped == mapped(None));
    }

    #[test]
    fn without_a_disk_it_stays_in_memory() {
        let swap = SwapFiles::beyond("/nonexistent".into(), 0);
        assert!(Buffer::<u8>::from(vec![1; 100]).swapped_out(&swap).is_none());
        assert!(Buffer::<u8>::default().swapped_out(&swap).is_none());
    }
}
