//! A device node, and the calls of V4L2 that loopbox makes on it, as safe functions.

use super::controls::Controls;
use super::format::{Choice, FormatSizes, PixelFormat, Rates, Size, Sizes};
use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::{AsRawFd, RawFd};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use v4l::v4l_sys as sys;
use v4l::v4l2::{self, vidioc};

/// `V4L2_BUF_TYPE_VIDEO_CAPTURE`.
pub const CAPTURE: u32 = 1;
const CAP_VIDEO_CAPTURE: u32 = 0x0000_0001;
const CAP_VIDEO_M2M: u32 = 0x0000_8000;
const CAP_STREAMING: u32 = 0x0400_0000;
const CAP_DEVICE_CAPS: u32 = 0x8000_0000;
/// `V4L2_FRMSIZE_TYPE_DISCRETE` and `V4L2_FRMIVAL_TYPE_DISCRETE`.
const DISCRETE: u32 = 1;
/// `V4L2_FIELD_NONE`: whole frames.
const FIELD_NONE: u32 = 1;
/// `V4L2_FIELD_INTERLACED`, `_TB` and `_BT`: both fields in one frame.
const FIELDS_INTERLACED: [u32; 3] = [4, 8, 9];
const CTRL_UNUSABLE: u32 = 0x0001 | 0x0002 | 0x0004; // disabled, grabbed, read-only
/// More than any driver lists; a driver that never ends its list must not hold us.
const LIST_LIMIT: u32 = 256;

/// A device node, open.
#[derive(Debug)]
pub struct Node(File);

/// The identity of a device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Its name, for people.
    pub card: String,
    /// Its driver.
    pub driver: String,
    /// Where it is plugged in.
    pub bus: String,
}

/// The format that a driver has set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// The format; `None`: one that loopbox does not read.
    pub format: Option<PixelFormat>,
    /// The size.
    pub size: Size,
    /// Bytes from one row to the next; 0 for compressed formats.
    pub step: u32,
    /// How fields make up frames.
    pub fields: Fields,
}

/// How fields make up frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fields {
    /// Whole frames.
    None,
    /// Even and odd rows taken at different times.
    Interlaced,
    /// One field a frame, half the rows.
    Apart,
}

impl Node {
    /// Opens a device node.
    ///
    /// # Errors
    /// As the system reports them.
    pub fn open(path: &Path) -> io::Result<Self> {
        // Not blocking, so that no call can hang on a device that is gone.
        OpenOptions::new().read(true).write(true).custom_flags(libc::O_NONBLOCK).open(path).map(Self)
    }

    /// The file descriptor.
    pub fn fd(&self) -> RawFd {
        self.0.as_raw_fd()
    }

    /// Makes a call.
    ///
    /// # Safety
    /// `T` must be the type that `request` stands for, and pointers in it valid.
    pub unsafe fn call<T>(&self, request: vidioc::_IOC_TYPE, argument: &mut T) -> io::Result<()> {
        loop {
            // SAFETY: the argument is a live, exclusive reference to the type that the caller vouches for.
            let result = unsafe { v4l2::ioctl(self.fd(), request, std::ptr::from_mut(argument).cast()) };
            match result {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                result => return result,
            }
        }
    }

    /// The identity of the device, and whether images can be streamed from it.
    ///
    /// # Errors
    /// When it is no V4L2 device.
    pub fn identity(&self) -> io::Result<(Identity, bool)> {
        let mut answer: sys::v4l2_capability = zeroed();
        // SAFETY: the type belongs to the request.
        unsafe { self.call(vidioc::VIDIOC_QUERYCAP, &mut answer)? };
        // The capabilities of this node, where the driver tells them from those of the whole device.
        let all = answer.capabilities;
        let own = if all & CAP_DEVICE_CAPS != 0 { answer.device_caps } else { all };
        let wanted = CAP_VIDEO_CAPTURE | CAP_STREAMING;
        let is_camera = own & wanted == wanted && own & CAP_VIDEO_M2M == 0;
        let (card, driver, bus) = (text(&answer.card), text(&answer.driver), text(&answer.bus_info));
        Ok((Identity { card, driver, bus }, is_camera))
    }

    /// The formats, sizes and rates that loopbox can use, and the names of other formats.
    ///
    /// # Errors
    /// When the device is gone.
    pub fn formats(&self) -> io::Result<(Vec<FormatSizes>, Vec<String>)> {
        let (mut formats, mut others) = (Vec::<FormatSizes>::new(), Vec::new());
        for index in 0..LIST_LIMIT {
            let mut answer = sys::v4l2_fmtdesc { index, type_: CAPTURE, ..zeroed() };
            // SAFETY: the type belongs to the request.
            if !listed(unsafe { self.call(vidioc::VIDIOC_ENUM_FMT, &mut answer) })? {
                break;
            }
            let code = answer.pixelformat.to_le_bytes();
            match PixelFormat::of_code(code) {
                Some(format) if formats.iter().all(|known| known.format != format) => {
                    formats.push(FormatSizes { format, sizes: self.sizes(answer.pixelformat)? });
                }
                Some(_) => {}
                None => others.push(String::from_utf8_lossy(&code).trim().to_owned()),
            }
        }
        Ok((formats, others))
    }

    fn sizes(&self, code: u32) -> io::Result<Sizes> {
        let mut list = Vec::new();
        for index in 0..LIST_LIMIT {
            let mut answer = sys::v4l2_frmsizeenum { index, pixel_format: code, ..zeroed() };
            // SAFETY: the type belongs to the request.
            if !listed(unsafe { self.call(vidioc::VIDIOC_ENUM_FRAMESIZES, &mut answer) })? {
                break;
            }
            if answer.type_ != DISCRETE {
                // SAFETY: the type says that it is this member.
                let range = unsafe { answer.__bindgen_anon_1.stepwise };
                let max = Size { width: range.max_width, height: range.max_height };
                return Ok(Sizes::Range {
                    min: Size { width: range.min_width, height: range.min_height },
                    max,
                    step: (range.step_width, range.step_height),
                    rates: self.rates(code, max)?,
                });
            }
            // SAFETY: the type says that it is this member.
            let size = unsafe { answer.__bindgen_anon_1.discrete };
            let size = Size { width: size.width, height: size.height };
            list.push((size, self.rates(code, size)?));
        }
        if list.is_empty() {
            return Ok(Sizes::Present(self.shape()?.size));
        }
        Ok(Sizes::List(list))
    }

    fn rates(&self, code: u32, size: Size) -> io::Result<Rates> {
        let mut list = Vec::new();
        for index in 0..LIST_LIMIT {
            let mut answer = sys::v4l2_frmivalenum {
                index,
                pixel_format: code,
                width: size.width,
                height: size.height,
                ..zeroed()
            };
            // SAFETY: the type belongs to the request.
            if !listed(unsafe { self.call(vidioc::VIDIOC_ENUM_FRAMEINTERVALS, &mut answer) })? {
                break;
            }
            if answer.type_ != DISCRETE {
                // SAFETY: the type says that it is this member.
                let range = unsafe { answer.__bindgen_anon_1.stepwise };
                // The longest interval is the lowest rate.
                let ends = rate(&range.max).zip(rate(&range.min));
                return Ok(ends.map_or(Rates::Unknown, |(low, high)| Rates::Range(low, high)));
            }
            // SAFETY: the type says that it is this member.
            list.extend(rate(unsafe { &answer.__bindgen_anon_1.discrete }));
        }
        Ok(if list.is_empty() { Rates::Unknown } else { Rates::List(list) })
    }

    fn shape(&self) -> io::Result<Shape> {
        let mut format = sys::v4l2_format { type_: CAPTURE, ..zeroed() };
        // SAFETY: the type belongs to the request.
        unsafe { self.call(vidioc::VIDIOC_G_FMT, &mut format)? };
        Ok(shape_of(&format))
    }

    /// Requests a format and size; returns those that the driver set.
    ///
    /// # Errors
    /// When another program streams from the device, or it is gone.
    pub fn set_format(&self, choice: &Choice) -> io::Result<Shape> {
        let mut format = sys::v4l2_format { type_: CAPTURE, ..zeroed() };
        format.fmt.pix = sys::v4l2_pix_format {
            width: choice.size.width,
            height: choice.size.height,
            pixelformat: u32::from_le_bytes(choice.format.code()),
            field: FIELD_NONE,
            ..zeroed()
        };
        // SAFETY: the type belongs to the request.
        unsafe { self.call(vidioc::VIDIOC_S_FMT, &mut format)? };
        Ok(shape_of(&format))
    }

    /// Requests a frame rate; returns the one that the driver set, `None` when it does not report it.
    pub fn set_rate(&self, fps: f64) -> Option<f64> {
        let mut parameters = sys::v4l2_streamparm { type_: CAPTURE, ..zeroed() };
        // SAFETY: the type belongs to the request.
        unsafe { self.call(vidioc::VIDIOC_G_PARM, &mut parameters).ok()? };
        // SAFETY: for a capture type it is this member; any bits are a valid value.
        let capture = unsafe { &mut parameters.parm.capture };
        capture.timeperframe =
            sys::v4l2_fract { numerator: 1000, denominator: (fps * 1000.0).round() as u32 };
        // SAFETY: the type belongs to the request.
        unsafe { self.call(vidioc::VIDIOC_S_PARM, &mut parameters).ok()? };
        // SAFETY: as above.
        rate(unsafe { &parameters.parm.capture.timeperframe })
    }
}

impl Controls for Node {
    fn get(&self, id: u32) -> io::Result<Option<i32>> {
        let mut query = sys::v4l2_queryctrl { id, ..zeroed() };
        // SAFETY: the type belongs to the request.
        if !listed(unsafe { self.call(vidioc::VIDIOC_QUERYCTRL, &mut query) })? {
            return Ok(None);
        }
        if query.flags & CTRL_UNUSABLE != 0 {
            return Ok(None);
        }
        let mut control = sys::v4l2_control { id, value: 0 };
        // SAFETY: the type belongs to the request.
        unsafe { self.call(vidioc::VIDIOC_G_CTRL, &mut control)? };
        Ok(Some(control.value))
    }

    fn set(&self, id: u32, value: i32) -> io::Result<()> {
        let mut control = sys::v4l2_control { id, value };
        // SAFETY: the type belongs to the request.
        unsafe { self.call(vidioc::VIDIOC_S_CTRL, &mut control) }
    }
}

fn shape_of(format: &sys::v4l2_format) -> Shape {
    // SAFETY: for a capture type it is this member; any bits are a valid value.
    let pixels = unsafe { format.fmt.pix };
    let fields = match pixels.field {
        0 | FIELD_NONE => Fields::None,
        field if FIELDS_INTERLACED.contains(&field) => Fields::Interlaced,
        _ => Fields::Apart,
    };
    Shape {
        format: PixelFormat::of_code(pixels.pixelformat.to_le_bytes()),
        size: Size { width: pixels.width, height: pixels.height },
        step: pixels.bytesperline,
        fields,
    }
}

/// Whether an entry of a list was there: lists end with EINVAL, and drivers without the list say ENOTTY or ENODATA.
fn listed(result: io::Result<()>) -> io::Result<bool> {
    match result {
        Ok(()) => Ok(true),
        Err(error) if matches!(error.raw_os_error(), Some(libc::EINVAL | libc::ENOTTY | libc::ENODATA)) => {
            Ok(false)
        }
        Err(error) => Err(error),
    }
}

/// Frames per second of a frame's time.
fn rate(interval: &sys::v4l2_fract) -> Option<f64> {
    let rate = interval.denominator as f64 / interval.numerator as f64;
    (rate.is_finite() && rate > 0.0).then_some(rate)
}

/// The text before the first zero.
fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|&b| b == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).trim().to_owned()
}

/// A struct of the kernel's interface with all bits zero, as its calls want them.
pub fn zeroed<T>() -> T {
    // SAFETY: used only for the plain C structs of V4L2, in which all members may be zero.
    unsafe { std::mem::zeroed() }
}
