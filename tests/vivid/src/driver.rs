//! The driver `vivid`: its input, output, timings and controls, so that what is written to the output device
//! comes out of the capture device.

use crate::layout;
use anyhow::{Context, Result, bail, ensure};
use std::ffi::{c_int, c_ulong, c_void};
use std::mem;
use std::path::Path;
use v4l::control::{Control, Value};
use v4l::v4l_sys::{v4l2_bt_timings, v4l2_dv_timings, v4l2_enum_dv_timings};
use v4l::v4l2::vidioc::{VIDIOC_S_INPUT, VIDIOC_S_OUTPUT};
use v4l::video::{Capture, Output};
use v4l::{Device, Format, FourCC};

/// Where pictures are captured.
pub const CAPTURE: &str = "/dev/video0";
/// Where they are played.
pub const OUTPUT: &str = "/dev/video1";

/// Inputs in the order of the module's parameter `input_types`, which `script/vivid` sets.
pub mod input {
    /// Looped from the output.
    pub const HDMI: i32 = 0;
    /// A test pattern, with sizes and rates to choose from.
    pub const WEBCAM: i32 = 1;
}

/// How pictures go through the driver.
#[derive(Clone, Copy, Debug)]
pub struct Mode {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// One of [`layout::FORMATS`].
    pub format: &'static str,
    /// Frames per second of the capture device.
    pub rate: f64,
}

impl Mode {
    /// What most checks use.
    pub const USUAL: Self = Self { width: 640, height: 480, format: "GREY", rate: 30.0 };
}

/// Opens a device.
///
/// # Errors
/// When that is not possible.
pub fn open(path: &str) -> Result<Device> {
    Device::with_path(Path::new(path)).with_context(|| format!("{path} cannot be opened"))
}

/// Connects output and input, both in this mode, and clears the text that the driver writes over pictures.
///
/// The driver's timings are those of television and monitors; larger ones than the pictures are cropped.
///
/// # Errors
/// When the driver refuses.
pub fn connect(mode: &Mode) -> Result<()> {
    let (capture, output) = (open(CAPTURE)?, open(OUTPUT)?);
    select(&capture, VIDIOC_S_INPUT, input::HDMI)?;
    select(&output, VIDIOC_S_OUTPUT, 0)?;
    for device in [&capture, &output] {
        set_timings(device, mode)?;
    }
    set_control(&capture, "Loop Video", 1)?;
    set_control(&capture, "OSD Text Mode", 2)?;
    let format = Format::new(mode.width, mode.height, FourCC::new(&layout::code(mode.format)?));
    let set = [Output::set_format(&output, &format)?, Capture::set_format(&capture, &format)?];
    for got in set {
        ensure!(
            (got.width, got.height, got.fourcc) == (format.width, format.height, format.fourcc),
            "the driver takes {got} instead of {mode:?}"
        );
    }
    Ok(())
}

/// Makes the capture device a webcam with a test pattern.
///
/// # Errors
/// When the driver refuses.
pub fn be_a_webcam() -> Result<()> {
    select(&open(CAPTURE)?, VIDIOC_S_INPUT, input::WEBCAM)
}

fn select(device: &Device, request: c_ulong, index: i32) -> Result<()> {
    let mut index: c_int = index;
    ioctl(device, request, &mut index).context("selecting an input or output")
}

/// Sets a control by its name.
///
/// # Errors
/// When there is none of this name, or the driver refuses.
pub fn set_control(device: &Device, name: &str, value: i64) -> Result<()> {
    let id = control_id(device, name)?;
    device
        .set_control(Control { id, value: Value::Integer(value) })
        .with_context(|| format!("control {name}"))
}

/// A control's value by its name.
///
/// # Errors
/// When there is none of this name, or it is not a number.
pub fn control(device: &Device, name: &str) -> Result<i64> {
    match device.control(control_id(device, name)?)?.value {
        Value::Integer(value) => Ok(value),
        Value::Boolean(value) => Ok(value.into()),
        other => bail!("control {name} is {other:?}"),
    }
}

fn control_id(device: &Device, name: &str) -> Result<u32> {
    let controls = device.query_controls()?;
    let found = controls.iter().find(|control| control.name == name);
    found.map(|control| control.id).with_context(|| format!("the driver has no control {name}"))
}

/// The smallest timings that hold the picture at about the rate.
fn set_timings(device: &Device, mode: &Mode) -> Result<()> {
    let fits = |t: &v4l2_bt_timings| {
        t.interlaced == 0
            && t.width >= mode.width
            && t.height >= mode.height
            && (rate(t) - mode.rate).abs() < 0.6
    };
    let timings = all_timings(device).into_iter().filter(|timings| fits(&picture_timings(timings)));
    let smallest = timings.min_by_key(|timings| {
        let t = picture_timings(timings);
        t.width as u64 * t.height as u64
    });
    let mut wanted = match smallest {
        Some(timings) => timings,
        None => slow_timings(mode)?,
    };
    ioctl(device, request::<v4l2_dv_timings>(87), &mut wanted).context("setting the timings")?;
    let set = picture_timings(&wanted);
    ensure!(fits(&set), "the driver makes timings of {:.2} Hz for {mode:?}", rate(&set));
    Ok(())
}

/// Timings at a rate that neither television nor monitors have, by VESA's formula for displays without a tube (CVT with
/// reduced blanking): of a frame as large as the driver wants, in whose corner the picture lies.
fn slow_timings(mode: &Mode) -> Result<v4l2_dv_timings> {
    /// `V4L2_DV_BT_STD_CVT`.
    const CVT: u32 = 1 << 2;
    /// `V4L2_DV_HSYNC_POS_POL`: that blanking is reduced.
    const REDUCED: u32 = 2;
    /// The driver's slowest clock, pixels a second, with room for rounding.
    const CLOCK: f64 = 15e6;
    /// The driver's largest frame, rows.
    const LARGEST: u32 = 2160;
    /// Columns over rows, as a sync of four rows says.
    const ASPECT: f64 = 4.0 / 3.0;
    /// Rows and columns without picture: before, during and after the sync.
    const ROWS: [u32; 3] = [3, 4, 7];
    const COLUMNS: [u32; 3] = [48, 32, 80];

    // 4:3 exactly.
    let height = (CLOCK / mode.rate / ASPECT).sqrt() as u32 / 6 * 6;
    let width = height / 3 * 4;
    let holds = mode.height <= height && mode.width <= width && height <= LARGEST;
    ensure!(holds, "the driver has no timings for {mode:?}");
    let total = |picture: u32, blank: [u32; 3]| f64::from(picture + blank.iter().sum::<u32>());
    // SAFETY: the kernel's structures are plain numbers, for which zeros are a value.
    let (mut timings, none): (v4l2_dv_timings, v4l2_bt_timings) = unsafe { (mem::zeroed(), mem::zeroed()) };
    timings.__bindgen_anon_1.bt = v4l2_bt_timings {
        width,
        height,
        polarities: REDUCED,
        pixelclock: (total(width, COLUMNS) * total(height, ROWS) * mode.rate) as u64,
        hfrontporch: COLUMNS[0],
        hsync: COLUMNS[1],
        hbackporch: COLUMNS[2],
        vfrontporch: ROWS[0],
        vsync: ROWS[1],
        vbackporch: ROWS[2],
        standards: CVT,
        ..none
    };
    Ok(timings)
}

fn all_timings(device: &Device) -> Vec<v4l2_dv_timings> {
    let at = |index| {
        // SAFETY: the kernel's structure is plain numbers, for which zeros are a value.
        let mut entry: v4l2_enum_dv_timings = unsafe { mem::zeroed() };
        entry.index = index;
        ioctl(device, request::<v4l2_enum_dv_timings>(98), &mut entry).ok().map(|()| entry.timings)
    };
    (0..).map_while(at).collect()
}

fn picture_timings(timings: &v4l2_dv_timings) -> v4l2_bt_timings {
    // SAFETY: the union holds this in all timings that there are (V4L2_DV_BT_656_1120).
    unsafe { timings.__bindgen_anon_1.bt }
}

fn rate(t: &v4l2_bt_timings) -> f64 {
    let columns = t.width + t.hfrontporch + t.hsync + t.hbackporch;
    let rows = t.height + t.vfrontporch + t.vsync + t.vbackporch;
    let pixels = t.pixelclock;
    pixels as f64 / (columns as f64 * rows as f64)
}

/// `_IOWR('V', number, T)` of `linux/ioctl.h`.
const fn request<T>(number: c_ulong) -> c_ulong {
    3 << 30 | (mem::size_of::<T>() as c_ulong) << 16 | (b'V' as c_ulong) << 8 | number
}

fn ioctl<T>(device: &Device, request: c_ulong, argument: &mut T) -> std::io::Result<()> {
    // SAFETY: every caller passes the structure that belongs to the request.
    unsafe { v4l::v4l2::ioctl(device.handle().fd(), request, std::ptr::from_mut(argument).cast::<c_void>()) }
}
