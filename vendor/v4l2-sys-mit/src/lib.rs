//! Types and numbers of Video4Linux, for 64-bit Linux: there `long` and the times in a buffer have one size on every processor.
//!
//! `bindings.rs` is what bindgen 0.65.1 makes of `linux/videodev2.h` of Linux 6.1 (`GPL-2.0 WITH Linux-syscall-note OR
//! BSD-3-Clause`, here under the latter; copyright (C) 1999-2012 the contributors): its items whose names begin with `v4l2_`, `V4L2_` or `VIDEO_MAX` and the types that these use, without tests.
#![allow(clippy::all)]
#![allow(missing_docs, non_camel_case_types, non_snake_case, non_upper_case_globals)]

#[cfg(not(target_pointer_width = "64"))]
compile_error!("these bindings are of 64-bit Linux: for others remove [patch.crates-io] from Cargo.toml, and have libclang");

#[rustfmt::skip]
mod bindings;
pub use bindings::*;

/// What the kernel takes, by size: another size would be another call.
const _: () = {
    use std::mem::size_of;
    assert!(size_of::<v4l2_capability>() == 104);
    assert!(size_of::<v4l2_format>() == 208);
    assert!(size_of::<v4l2_buffer>() == 88);
    assert!(size_of::<v4l2_requestbuffers>() == 20);
    assert!(size_of::<v4l2_query_ext_ctrl>() == 232);
    assert!(size_of::<v4l2_ext_control>() == 20);
    assert!(size_of::<v4l2_ext_controls>() == 32);
    assert!(size_of::<v4l2_frmsizeenum>() == 44);
    assert!(size_of::<v4l2_frmivalenum>() == 52);
    assert!(size_of::<v4l2_streamparm>() == 204);
    assert!(size_of::<v4l2_fmtdesc>() == 64);
    assert!(size_of::<v4l2_querymenu>() == 44);
};
