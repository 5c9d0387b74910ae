//! The recorder: takes frames from capture and writes them in a thread of its own.

use super::picture;
use super::writer::{Head, RecordingWriter};
use crate::pictures::Picture;
use crate::{SourceFrame, time};
use anyhow::{Context, Result, anyhow, bail};
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Bytes of pictures that may wait to be written: some seconds of a common camera.
const QUEUE_BYTES: usize = 64 << 20;
/// What a frame counts at least, so that files not yet read are bounded too.
const LEAST_BYTES: usize = 256 << 10;
/// A killed process loses no more than this and the time of one write.
const FLUSH_INTERVAL: Duration = Duration::from_millis(500);

/// A handle on the current recording, if there is one. Clones share it.
#[derive(Clone, Default)]
pub struct Recorder(Arc<Mutex<Option<Active>>>);

/// The summary of a finished recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// The file.
    pub path: PathBuf,
    /// Frames in it.
    pub frames: u64,
    /// Frames in it that the run did not process.
    pub dropped: u64,
    /// Frames that are not in it, because the disk was too slow.
    pub left_out: u64,
    /// Frames that are not in it, because there was no picture to record, and why the first was not.
    pub unreadable: (u64, Option<String>),
    /// Bytes of the file.
    pub bytes: u64,
}

impl Summary {
    /// The summary for people, in one line.
    pub fn text(&self) -> String {
        let mut text = format!(
            "{} frames recorded in {} ({:.1} MB)",
            self.frames,
            self.path.display(),
            self.bytes as f64 / 1e6
        );
        if self.left_out > 0 {
            text += &format!("; {} FRAMES LEFT OUT: the disk was too slow", self.left_out);
        }
        if let (count @ 1.., Some(reason)) = &self.unreadable {
            text += &format!("; left out without a readable image: {count} ({reason})");
        }
        text
    }
}

struct Active {
    path: PathBuf,
    commands: Sender<Command>,
    waiting: Arc<Waiting>,
    thread: Option<JoinHandle<Result<Summary>>>,
    left_out: u64,
    /// Told already that frames are left out, or that the thread has ended.
    warned: bool,
}

enum Command {
    Frame(SourceFrame, usize),
    Dropped(u64),
    /// The end, with the number of frames left out.
    Finish(u64),
}

/// Bytes of pictures that wait.
#[derive(Default)]
struct Waiting {
    bytes: Mutex<usize>,
    fell: Condvar,
}

impl Recorder {
    /// A recorder that records nothing until it is started.
    pub fn idle() -> Self {
        Self::default()
    }

    /// Begins a recording in a new file; its head is on the disk when this returns.
    ///
    /// # Errors
    /// When a recording is running already, or the file exists or cannot be created.
    pub fn start(&self, path: &Path, head: &Head) -> Result<()> {
        let mut active = self.lock();
        if let Some(active) = &*active {
            bail!("{}: a recording goes on already", active.path.display());
        }
        refuse_existing(path)?;
        let begin = || -> Result<_> {
            let file = File::options().write(true).create_new(true).open(path)?;
            let sync = file.try_clone()?;
            let begun = RecordingWriter::create(BufWriter::with_capacity(1 << 18, file), head);
            let writer = begun.inspect_err(|_| drop(std::fs::remove_file(path)))?;
            sync.sync_data()?;
            Ok(Writing { writer, sync, path: path.to_owned(), unreadable: (0, None) })
        };
        let writing = begin().with_context(|| format!("{}: cannot be recorded to", path.display()))?;
        let (commands, receiver) = channel();
        let waiting = Arc::<Waiting>::default();
        let of_thread = Arc::clone(&waiting);
        let thread = std::thread::Builder::new()
            .name("record".into())
            .spawn(move || writing.run(&receiver, &of_thread))
            .context("cannot start the recording thread")?;
        let path = path.to_owned();
        *active = Some(Active { path, commands, waiting, thread: Some(thread), left_out: 0, warned: false });
        Ok(())
    }

    /// Ends the recording and waits until it is on the disk.
    ///
    /// # Errors
    /// When no recording is running, or it could not be written; what was written before is in the file.
    pub fn stop(&self) -> Result<Summary> {
        let active = self.lock().take().context("there is no recording to stop")?;
        active.finish()
    }

    /// Whether a recording is running.
    pub fn is_recording(&self) -> bool {
        self.lock().is_some()
    }

    /// The file that is being recorded to.
    pub fn path(&self) -> Option<PathBuf> {
        self.lock().as_ref().map(|active| active.path.clone())
    }

    /// Records a frame; where the disk is too slow, leaves it out rather than wait.
    pub fn frame(&self, frame: &SourceFrame) {
        if let Some(active) = &mut *self.lock() {
            active.frame(frame, false);
        }
    }

    /// Records a frame; waits where the disk is slow. For sources that can wait, too.
    pub fn frame_waiting(&self, frame: &SourceFrame) {
        if let Some(active) = &mut *self.lock() {
            active.frame(frame, true);
        }
    }

    /// Notes that the run did not process a frame that is recorded.
    pub fn dropped(&self, index: u64) {
        if let Some(active) = &*self.lock() {
            // A thread that has ended is reported by `stop`.
            let _ = active.commands.send(Command::Dropped(index));
        }
    }

    /// Whether writing failed; [`stop`](Self::stop) returns the reason.
    pub fn has_failed(&self) -> bool {
        self.lock().as_ref().is_some_and(Active::has_failed)
    }

    /// The warning that the user has not seen yet; each is returned once.
    pub fn take_warning(&self) -> Option<String> {
        self.lock().as_mut()?.take_warning()
    }

    fn lock(&self) -> MutexGuard<'_, Option<Active>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Refuses a name that another kind of file goes by; without an ending it is taken.
///
/// # Errors
/// When it ends in anything but `.mcap`.
pub fn check_name(path: &Path) -> Result<()> {
    if path.extension().is_some_and(|extension| !extension.eq_ignore_ascii_case("mcap")) {
        bail!(
            "{}: recordings are MCAP files\nhint: end the name in .mcap; `loopbox convert` makes other forms of it",
            path.display()
        );
    }
    Ok(())
}

/// Most bytes of a name that becomes a file's: file systems take 255, and numbers and endings come behind it.
const LONGEST_NAME: usize = 200;

/// Refuses a name that no file can have, or none with what is put behind it.
///
/// # Errors
/// When it is too long.
pub fn check_length(path: &Path) -> Result<()> {
    let length = path.file_name().map_or(0, |name| name.len());
    if length > LONGEST_NAME {
        bail!(
            "a name of {length} bytes is too long for a file: {}\nhint: give one of {LONGEST_NAME} at most",
            path.display()
        );
    }
    Ok(())
}

/// Refuses to record over a file.
///
/// # Errors
/// When it is there.
pub fn refuse_existing(path: &Path) -> Result<()> {
    if path.symlink_metadata().is_ok() {
        bail!("{}: there is a file already\nhint: name another one, or remove it", path.display());
    }
    Ok(())
}

impl Active {
    fn frame(&mut self, frame: &SourceFrame, may_wait: bool) {
        let bytes = frame.picture.bytes().max(LEAST_BYTES);
        if !self.waiting.admit(bytes, may_wait) {
            self.left_out += 1;
            return;
        }
        let copy = SourceFrame { picture: frame.picture.clone(), ..*frame };
        if self.commands.send(Command::Frame(copy, bytes)).is_err() {
            self.waiting.leave(bytes);
        }
    }

    fn has_failed(&self) -> bool {
        self.thread.as_ref().is_some_and(JoinHandle::is_finished)
    }

    fn take_warning(&mut self) -> Option<String> {
        let failed = self.has_failed();
        if self.warned || !(failed || self.left_out > 0) {
            return None;
        }
        self.warned = true;
        let path = self.path.display();
        Some(if failed {
            format!("{path}: the recording has failed; the run goes on without")
        } else {
            format!("{path}: the disk is too slow for the camera: frames are left out of the recording")
        })
    }

    fn finish(mut self) -> Result<Summary> {
        let path = self.path.clone();
        // A thread that has ended says itself why.
        let _ = self.commands.send(Command::Finish(self.left_out));
        let ended = self.thread.take().map(JoinHandle::join);
        let written = ended.unwrap_or_else(|| Ok(Err(anyhow!("it was ended before"))));
        let written = written.unwrap_or_else(|_| Err(anyhow!("the recording thread broke down")));
        written.with_context(|| {
            let hint = "hint: what was written before can be replayed; is the disk full?";
            format!("{}: the recording is not complete\n{hint}", path.display())
        })
    }
}

impl Drop for Active {
    fn drop(&mut self) {
        // After an error elsewhere nobody has stopped it: end the file well all the same.
        if let Some(thread) = self.thread.take() {
            let _ = self.commands.send(Command::Finish(self.left_out));
            let _ = thread.join();
        }
    }
}

impl Waiting {
    /// Takes room for a picture, waiting for it where that is allowed; false when there is none.
    fn admit(&self, bytes: usize, may_wait: bool) -> bool {
        let mut waiting = self.lock();
        // One picture is always taken, however large.
        while *waiting > 0 && *waiting + bytes > QUEUE_BYTES {
            if !may_wait {
                return false;
            }
            waiting = self.fell.wait(waiting).unwrap_or_else(PoisonError::into_inner);
        }
        *waiting += bytes;
        true
    }

    fn leave(&self, bytes: usize) {
        let mut waiting = self.lock();
        *waiting = waiting.saturating_sub(bytes);
        self.fell.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, usize> {
        self.bytes.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What the thread owns.
struct Writing {
    writer: RecordingWriter<BufWriter<File>>,
    sync: File,
    path: PathBuf,
    unreadable: (u64, Option<String>),
}

/// Frees everyone who waits, however the thread ends.
struct FreeOnDrop<'a>(&'a Waiting);

impl Drop for FreeOnDrop<'_> {
    fn drop(&mut self) {
        *self.0.lock() = 0;
        self.0.fell.notify_all();
    }
}

impl Writing {
    fn run(mut self, commands: &Receiver<Command>, waiting: &Waiting) -> Result<Summary> {
        let _frees = FreeOnDrop(waiting);
        let mut due = Instant::now() + FLUSH_INTERVAL;
        let mut left_out = 0;
        loop {
            match commands.recv_timeout(due.saturating_duration_since(Instant::now())) {
                Ok(Command::Frame(frame, bytes)) => {
                    let written = self.frame(frame);
                    waiting.leave(bytes);
                    written?;
                }
                Ok(Command::Dropped(index)) => self.writer.dropped(index)?,
                Ok(Command::Finish(count)) => {
                    left_out = count;
                    break;
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            if Instant::now() >= due {
                self.writer.flush()?;
                self.sync.sync_data()?;
                due = Instant::now() + FLUSH_INTERVAL;
            }
        }
        self.writer.finish(left_out)?;
        self.sync.sync_all()?;
        Ok(Summary {
            frames: self.writer.frames(),
            dropped: self.writer.dropped_count(),
            left_out,
            unreadable: self.unreadable,
            bytes: self.sync.metadata()?.len(),
            path: self.path,
        })
    }

    fn frame(&mut self, frame: SourceFrame) -> Result<()> {
        if let Picture::Ranged(_, range) = &frame.picture {
            self.writer.grey_range(*range);
        }
        // Such a frame is none of the run either, which is not worth the end of the recording.
        let time = time::nanoseconds(frame.timestamp);
        let time = time.ok_or_else(|| format!("no recording can hold the time stamp {}", frame.timestamp));
        match time.and_then(|_| picture::encode(frame.picture)) {
            Ok(encoded) => self.writer.frame(frame.index, frame.timestamp, encoded),
            Err(reason) => {
                self.unreadable.0 += 1;
                self.unreadable.1.get_or_insert(reason);
                Ok(())
            }
        }
    }
}
