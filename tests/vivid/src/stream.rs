//! Streaming to the output device, from memory of our own: the driver's `write` is broken in some kernels, and the
//! streams of crate v4l wait for a buffer that this driver keeps until it gets the next one.

use anyhow::{Context, Result};
use std::ffi::{c_int, c_ulong, c_void};
use std::fs::{File, OpenOptions};
use std::os::fd::AsRawFd;
use std::{io, mem, ptr};
use v4l::v4l_sys::{v4l2_buffer, v4l2_requestbuffers};
use v4l::v4l2::vidioc::{VIDIOC_DQBUF, VIDIOC_QBUF, VIDIOC_REQBUFS, VIDIOC_STREAMON};

/// `V4L2_BUF_TYPE_VIDEO_OUTPUT`.
const OUTPUT: u32 = 2;
/// `V4L2_MEMORY_USERPTR`.
const OUR_MEMORY: u32 = 2;
/// The driver starts with two.
const BUFFERS: u32 = 3;

/// A running stream of frames, which it borrows: the driver reads them where they are.
pub struct Stream<'a> {
    device: File,
    queued: u32,
    frames: std::marker::PhantomData<&'a [u8]>,
}

impl<'a> Stream<'a> {
    /// Starts with a frame.
    ///
    /// # Errors
    /// When the driver refuses.
    pub fn start(path: &str, first: &'a [u8]) -> Result<Self> {
        let device = OpenOptions::new().read(true).write(true).open(path).context(path.to_owned())?;
        let mut stream = Self { device, queued: 0, frames: std::marker::PhantomData };
        let mut buffers =
            v4l2_requestbuffers { count: BUFFERS, type_: OUTPUT, memory: OUR_MEMORY, ..zeroed() };
        stream.call(VIDIOC_REQBUFS, &mut buffers).context("asking for buffers")?;
        stream.show(first)?;
        stream.show(first)?;
        let mut kind = OUTPUT as c_int;
        stream.call(VIDIOC_STREAMON, &mut kind).context("starting the stream")?;
        Ok(stream)
    }

    /// Shows a frame from the next tick of the output on, and until the one after it.
    ///
    /// # Errors
    /// When the device is gone.
    pub fn show(&mut self, frame: &'a [u8]) -> Result<()> {
        let index = if self.queued < BUFFERS {
            self.queued
        } else {
            let mut done = buffer(0);
            self.call(VIDIOC_DQBUF, &mut done).context("waiting for a buffer")?;
            done.index
        };
        self.queued = (self.queued + 1).min(BUFFERS);
        let mut next = buffer(index);
        next.length = frame.len() as u32;
        next.bytesused = next.length;
        next.m.userptr = frame.as_ptr() as c_ulong;
        self.call(VIDIOC_QBUF, &mut next).context("showing a frame")
    }

    fn call<T>(&self, request: c_ulong, argument: &mut T) -> io::Result<()> {
        // SAFETY: every caller passes the structure that belongs to the request; frames outlive the stream, which
        // ends when the device is closed.
        unsafe {
            v4l::v4l2::ioctl(self.device.as_raw_fd(), request, ptr::from_mut(argument).cast::<c_void>())
        }
    }
}

fn buffer(index: u32) -> v4l2_buffer {
    v4l2_buffer { index, type_: OUTPUT, memory: OUR_MEMORY, ..zeroed() }
}

fn zeroed<T>() -> T {
    // SAFETY: used for the kernel's structures only: plain numbers, for which zeros are a value.
    unsafe { mem::zeroed() }
}
