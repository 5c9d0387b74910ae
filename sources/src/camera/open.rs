//! Opening a camera and setting it up, the first time and when it is back.

use super::args::{CameraArgs, Lockable};
use super::controls::{Locked, Memory, any_automatic};
use super::device::{Captured, Device, View};
use super::failures::{explain, not_a_camera};
use super::format::{Choice, FormatRequest, FormatSizes, PixelFormat, Size, USUAL_RATE, choose, rate_text};
use super::list;
use super::node::{Fields, Identity, Node};
use super::stream::Stream;
use anyhow::{Result, anyhow, bail};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How long automatics may look at the scene before they are locked.
const WARM_UP: Duration = Duration::from_secs(1);

/// A camera of the kernel's Video4Linux, streaming.
struct Camera {
    /// Before the stream, so that the camera is put back while it still listens.
    _locked: Option<Locked>,
    stream: Stream,
    view: View,
}

impl Device for Camera {
    fn view(&self) -> View {
        self.view
    }

    fn next(&mut self, wait: Duration) -> io::Result<Option<Captured>> {
        self.stream.next(wait)
    }
}

/// How to open a certain camera.
pub struct Opener {
    path: PathBuf,
    request: FormatRequest,
    lock: Vec<Lockable>,
    memory: Memory,
    /// Which camera it was the first time.
    identity: Option<Identity>,
}

/// A camera just opened, with its description and warnings.
pub struct Opened {
    /// The camera.
    pub device: Box<dyn Device>,
    /// `Webcam, 640x480 YUYV at 30 frames/s`.
    pub description: String,
    /// Where the camera differs from the request.
    pub warnings: Vec<String>,
}

impl Opener {
    /// For the camera that the user names.
    ///
    /// # Errors
    /// When none is named.
    pub fn new(args: &CameraArgs) -> Result<Self> {
        let Some(path) = args.path() else {
            bail!("no camera is named\nhint: --camera /dev/video0; `loopbox cameras` lists those there are");
        };
        let request = FormatRequest { format: args.format.0, size: args.size, fps: args.fps };
        Ok(Self { path, request, lock: args.locks(), memory: Memory::default(), identity: None })
    }

    /// Opens the camera.
    ///
    /// # Errors
    /// Says what to do about it.
    pub fn open(&mut self) -> Result<Opened> {
        self.open_at(&self.path.clone())
    }

    /// Opens the camera where it is now; the system may have given it another number.
    ///
    /// # Errors
    /// While it is not back.
    pub fn open_again(&mut self) -> Result<Opened> {
        let identity = self.identity.as_ref();
        let found = list::nodes(Path::new("/dev")).into_iter().filter_map(|path| {
            let (present, is_camera) = Node::open(&path).ok()?.identity().ok()?;
            (is_camera && identity.is_none_or(|wanted| wanted.card == present.card))
                .then_some((path, present))
        });
        // The same port first, then the same node, then any camera of that name.
        let distance = |(path, present): &(PathBuf, Identity)| {
            (identity.is_none_or(|wanted| wanted.bus != present.bus), *path != self.path)
        };
        match found.min_by_key(distance) {
            Some((path, _)) => self.open_at(&path),
            None => Err(anyhow!("the camera is not there")),
        }
    }

    fn open_at(&mut self, path: &Path) -> Result<Opened> {
        let failed = |error: io::Error| explain(path, &error);
        let node = Arc::new(Node::open(path).map_err(failed)?);
        let (identity, is_camera) = node.identity().map_err(failed)?;
        if !is_camera {
            return Err(not_a_camera(path));
        }
        let (formats, others) = node.formats().map_err(failed)?;
        let choice =
            choose(&formats, &self.request).ok_or_else(|| refusal(path, &self.request, &formats, &others))?;
        let (view, mut warnings) = set_up(path, &node, &choice, &self.request, &formats)?;
        let mut stream = Stream::start(Arc::clone(&node)).map_err(failed)?;
        let locked = self.locked(&node, &mut stream, &mut warnings);
        let description = format!("{}, {}", identity.card, description(&view));
        self.identity.get_or_insert(identity);
        // Whatever comes back must look the same.
        self.request = FormatRequest { format: Some(view.format), size: Some(view.size), ..self.request };
        Ok(Opened { device: Box::new(Camera { _locked: locked, stream, view }), description, warnings })
    }

    fn locked(&self, node: &Arc<Node>, stream: &mut Stream, warnings: &mut Vec<String>) -> Option<Locked> {
        if self.lock.is_empty() {
            return None;
        }
        if any_automatic(&**node, &self.lock) && !self.memory.knows_values() {
            warm_up(stream);
        }
        let (locked, complaints) = Locked::new(node.clone(), &self.lock, &self.memory);
        warnings.extend(complaints);
        Some(locked)
    }
}

/// Lets the automatics find their values: without frames they do not work.
fn warm_up(stream: &mut Stream) {
    let started = Instant::now();
    while let Some(left) = WARM_UP.checked_sub(started.elapsed()) {
        if stream.next(left).is_err() {
            return;
        }
    }
}

/// Sets format and rate.
fn set_up(
    path: &Path,
    node: &Node,
    choice: &Choice,
    request: &FormatRequest,
    formats: &[FormatSizes],
) -> Result<(View, Vec<String>)> {
    let shape = node.set_format(choice).map_err(|error| explain(path, &error))?;
    if shape.format != Some(choice.format) || request.size.is_some_and(|size| size != shape.size) {
        let request = FormatRequest { format: Some(choice.format), ..*request };
        return Err(refusal(path, &request, formats, &[]));
    }
    let mut warnings = Vec::new();
    match shape.fields {
        Fields::None => {}
        Fields::Interlaced => warnings.push(format!(
            "{}: the images are interlaced: even and odd rows are taken at different times, which spoils tracking \
             when the camera moves fast",
            path.display()
        )),
        Fields::Apart => bail!(
            "{}: the device gives even and odd rows apart, which loopbox does not put together\nhint: choose a \
             progressive signal or another input (`v4l2-ctl --set-input`)",
            path.display()
        ),
    }
    let fps = request.fps.unwrap_or(choice.rate.unwrap_or(USUAL_RATE));
    let rate = node.set_rate(choice.rate.unwrap_or(fps));
    if let (Some(wanted), Some(rate)) = (request.fps, rate)
        && (rate - wanted).abs() > 0.05 * wanted
    {
        let (rate, wanted) = (rate_text(rate), rate_text(wanted));
        warnings.push(format!(
            "{}: {rate} frames/s, not {wanted}: the camera has no nearer rate",
            path.display()
        ));
    }
    let view = View { format: choice.format, size: shape.size, step: shape.step, rate };
    Ok((view, warnings))
}

fn description(view: &View) -> String {
    let rate = view.rate.map(|rate| format!(" at {} frames/s", rate_text(rate))).unwrap_or_default();
    format!("{} {}{rate}", view.size, view.format.name())
}

/// What the camera does not have, and what it has.
fn refusal(
    path: &Path,
    request: &FormatRequest,
    formats: &[FormatSizes],
    others: &[String],
) -> anyhow::Error {
    let path = path.display();
    if formats.is_empty() {
        let known = PixelFormat::ALL.map(PixelFormat::name).join(", ");
        return anyhow!(
            "{path}: none of the camera's pixel formats is read here (it has: {})\nhint: loopbox reads {known}",
            if others.is_empty() { "none".into() } else { others.join(", ") }
        );
    }
    let format = request.format.map(|format| format!(" {}", format.name())).unwrap_or_default();
    let size = request.size.map(|size: Size| format!(" at {size}")).unwrap_or_default();
    let offered: Vec<String> =
        formats.iter().map(|format| format!("{} {}", format.format.name(), format.sizes)).collect();
    anyhow!("{path}: the camera gives no{format} images{size}\nhint: it gives {}", offered.join("\n      "))
}

#[cfg(test)]
mod tests {
    use super::super::format::{Rates, Sizes};
    use super::*;

    #[test]
    fn a_refused_format_lists_what_there_is() {
        let sizes = Sizes::List(vec![(Size::USUAL, Rates::List(vec![30.0, 15.0]))]);
        let formats = [FormatSizes { format: PixelFormat::Yuyv, sizes }];
        let request = FormatRequest { format: Some(PixelFormat::Grey), size: Some(Size::USUAL), fps: None };
        let text = refusal(Path::new("/dev/video0"), &request, &formats, &[]).to_string();
        assert_eq!(
            text,
            "/dev/video0: the camera gives no GREY images at 640x480\nhint: it gives YUYV 640x480 at 30, 15"
        );
        let text = refusal(Path::new("/dev/video0"), &request, &[], &["H264".into()]).to_string();
        assert!(text.contains("it has: H264") && text.contains("reads GREY, NV12"), "{text}");
    }
}
