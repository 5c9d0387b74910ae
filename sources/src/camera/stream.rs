//! Frames from a device, through memory that it shares with us.

use super::device::Captured;
use super::node::{CAPTURE, Node, zeroed};
use std::io;
use std::sync::Arc;
use std::time::{Duration, Instant};
use v4l::v4l_sys as sys;
use v4l::v4l2::{self, vidioc};

/// Frames that the driver can fill while we look away.
pub const BUFFERS: u32 = 4;
/// `V4L2_MEMORY_MMAP`.
const MAPPED: u32 = 1;
const FLAG_ERROR: u32 = 0x0000_0040;
const STAMP_MASK: u32 = 0x0000_e000;
const STAMP_MONOTONIC: u32 = 0x0000_2000;

/// A running stream; it stops when dropped.
pub struct Stream {
    node: Arc<Node>,
    buffers: Vec<Mapping>,
}

/// Memory of the driver in our address space.
struct Mapping {
    start: *mut libc::c_void,
    length: usize,
}

// SAFETY: the pointer is to memory that belongs to the mapping alone, wherever its owner goes.
unsafe impl Send for Mapping {}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: made by mmap with this length, and nobody else knows the pointer. It cannot fail then.
        let _ = unsafe { v4l2::munmap(self.start, self.length) };
    }
}

impl Stream {
    /// Starts streaming.
    ///
    /// # Errors
    /// When another program streams from the device (EBUSY), or it has no memory or bandwidth left.
    pub fn start(node: Arc<Node>) -> io::Result<Self> {
        let mut request =
            sys::v4l2_requestbuffers { count: BUFFERS, type_: CAPTURE, memory: MAPPED, ..zeroed() };
        // SAFETY: the type belongs to the request.
        unsafe { node.call(vidioc::VIDIOC_REQBUFS, &mut request)? };
        let mut stream = Self { node, buffers: Vec::new() };
        for index in 0..request.count {
            let mapping = stream.map(index)?;
            stream.buffers.push(mapping);
            stream.queue(index)?;
        }
        let mut kind = CAPTURE as libc::c_int;
        // SAFETY: the type belongs to the request.
        unsafe { stream.node.call(vidioc::VIDIOC_STREAMON, &mut kind)? };
        Ok(stream)
    }

    fn map(&self, index: u32) -> io::Result<Mapping> {
        let mut buffer = buffer(index);
        // SAFETY: the type belongs to the request.
        unsafe { self.node.call(vidioc::VIDIOC_QUERYBUF, &mut buffer)? };
        let length = buffer.length as usize;
        // SAFETY: a new mapping, at an address that the system chooses, of the length that the driver has given.
        let start = unsafe {
            let offset = buffer.m.offset as libc::off_t;
            let access = libc::PROT_READ | libc::PROT_WRITE;
            v4l2::mmap(std::ptr::null_mut(), length, access, libc::MAP_SHARED, self.node.fd(), offset)?
        };
        Ok(Mapping { start, length })
    }

    fn queue(&self, index: u32) -> io::Result<()> {
        // SAFETY: the type belongs to the request.
        unsafe { self.node.call(vidioc::VIDIOC_QBUF, &mut buffer(index)) }
    }

    /// The next frame; `None` when there is none within `wait`.
    ///
    /// # Errors
    /// When the device is gone.
    pub fn next(&mut self, wait: Duration) -> io::Result<Option<Captured>> {
        let ready = self.poll(wait)?;
        if ready == 0 {
            return Ok(None);
        }
        let mut filled = buffer(0);
        // SAFETY: the type belongs to the request.
        match unsafe { self.node.call(vidioc::VIDIOC_DQBUF, &mut filled) } {
            Ok(()) => {}
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                let failed = ready & (libc::POLLERR | libc::POLLHUP | libc::POLLNVAL) != 0;
                return if failed { Err(io::Error::from_raw_os_error(libc::ENODEV)) } else { Ok(None) };
            }
            Err(error) => return Err(error),
        }
        let captured = self.copy(&filled);
        self.queue(filled.index)?;
        Ok(Some(captured))
    }

    fn poll(&self, wait: Duration) -> io::Result<libc::c_short> {
        let mut poll = libc::pollfd { fd: self.node.fd(), events: libc::POLLIN, revents: 0 };
        let wait = wait.as_millis().min(i32::MAX as u128) as i32;
        // SAFETY: one valid entry.
        match unsafe { libc::poll(&mut poll, 1, wait) } {
            -1 => {
                let error = io::Error::last_os_error();
                // A signal: the caller asks again, after it has seen whether to stop.
                if error.kind() == io::ErrorKind::Interrupted { Ok(0) } else { Err(error) }
            }
            _ => Ok(poll.revents),
        }
    }

    fn copy(&self, filled: &sys::v4l2_buffer) -> Captured {
        let data = self.buffers.get(filled.index as usize).map_or_else(Vec::new, |mapping| {
            let used = mapping.length.min(filled.bytesused as usize);
            // SAFETY: within the mapping; the driver has handed the buffer over and does not write to it now.
            unsafe { std::slice::from_raw_parts(mapping.start.cast::<u8>(), used) }.to_vec()
        });
        let (now, instant) = (monotonic(), Instant::now());
        let given = filled.timestamp.tv_sec as f64 + filled.timestamp.tv_usec as f64 * 1e-6;
        let timestamp = if filled.flags & STAMP_MASK == STAMP_MONOTONIC { given } else { now };
        let age = Duration::try_from_secs_f64(now - timestamp).unwrap_or_default();
        Captured {
            data,
            sequence: filled.sequence,
            timestamp,
            captured: instant.checked_sub(age).unwrap_or(instant),
            damaged: filled.flags & FLAG_ERROR != 0,
        }
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        let mut kind = CAPTURE as libc::c_int;
        // SAFETY: the type belongs to the request. A device that is gone refuses, and has stopped anyway.
        let _ = unsafe { self.node.call(vidioc::VIDIOC_STREAMOFF, &mut kind) };
        self.buffers.clear();
        let mut request = sys::v4l2_requestbuffers { count: 0, type_: CAPTURE, memory: MAPPED, ..zeroed() };
        // SAFETY: as above. The controls' guard may hold the node open longer: others can stream meanwhile.
        let _ = unsafe { self.node.call(vidioc::VIDIOC_REQBUFS, &mut request) };
    }
}

fn buffer(index: u32) -> sys::v4l2_buffer {
    sys::v4l2_buffer { index, type_: CAPTURE, memory: MAPPED, ..zeroed() }
}

/// Seconds of the clock that drivers stamp frames with.
fn monotonic() -> f64 {
    let mut time: libc::timespec = zeroed();
    // SAFETY: a valid place to write to; this clock is always there.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &mut time) };
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
