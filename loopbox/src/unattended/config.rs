//! What an unattended agent is told, in one file (TOML): `book/src/reference/agent-file.md` documents every key.

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Deserializer};
use slam_direct::Params;
use sources::camera::CameraArgs;
use sources::camera::args::{Lockable, RequestedFormat};
use sources::correction::{CameraOptions, DEFAULT_MAX_WIDTH};
use std::fs;
use std::net::{IpAddr, Ipv4Addr};
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// What the heartbeat is called in the folder `out`, unless the file says otherwise.
pub const HEARTBEAT: &str = "heartbeat.json";

/// The file, with paths as they stand in it.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AgentConfig {
    /// What people call the agent; by default the camera's or the recording's name.
    pub name: Option<String>,
    /// The folder of all that is kept.
    pub out: PathBuf,
    /// The file of the heartbeat; by default `heartbeat.json` in `out`.
    pub heartbeat: Option<PathBuf>,
    /// A parameter file, as `loopbox params` prints it.
    pub params: Option<PathBuf>,
    /// The camera.
    pub camera: Option<CameraConfig>,
    /// A recording in the place of a camera.
    pub recording: Option<RecordingConfig>,
    /// The map.
    #[serde(default)]
    pub map: MapConfig,
    /// Recording what the camera sees.
    #[serde(default)]
    pub record: RecordConfig,
    /// How much of the machine is used.
    #[serde(default)]
    pub limits: Limits,
    /// The page to watch from, and `/health`.
    pub page: Option<PageConfig>,
    /// Pairing with other agents.
    pub fleet: Option<FleetConfig>,
}

/// The camera.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// Its device node, such as `/dev/video0`.
    pub device: PathBuf,
    /// Its calibration.
    pub calibration: PathBuf,
    /// Inverse response of the sensor.
    pub response: Option<PathBuf>,
    /// Vignette of the lens.
    pub vignette: Option<PathBuf>,
    /// A grey image of the camera's size, black where its images are not to be used.
    pub mask: Option<PathBuf>,
    /// Frames per second.
    pub fps: Option<f64>,
    /// Pixel format.
    #[serde(default, deserialize_with = "from_text")]
    pub format: RequestedFormat,
    /// What is kept at its value instead of automatic.
    #[serde(default, deserialize_with = "from_texts")]
    pub lock: Vec<Lockable>,
    /// Images that are wider are halved until they are not.
    #[serde(default = "usual_width")]
    pub max_width: usize,
}

/// A recording in the place of a camera: the agent ends with it.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordingConfig {
    /// The recording, as `loopbox run` takes it.
    pub path: PathBuf,
    /// A calibration, if none came with it or another is wanted.
    pub calibration: Option<PathBuf>,
    /// Frames come by their time stamps, and are dropped when late; else every frame is tracked.
    #[serde(default)]
    pub realtime: bool,
    /// Images that are wider are halved until they are not.
    #[serde(default = "usual_width")]
    pub max_width: usize,
}

/// The map.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MapConfig {
    /// Whether a session goes on in the map of the one before.
    #[serde(rename = "continue")]
    pub resumes: bool,
    /// Whether keyframes' features are found beside tracking, by which maps are merged.
    pub features: bool,
}

impl Default for MapConfig {
    fn default() -> Self {
        Self { resumes: true, features: true }
    }
}

/// Recording what the camera sees.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordConfig {
    /// Whether frames are recorded.
    pub enabled: bool,
    /// A file that has become so large is ended and the next begun, MiB.
    pub file_mib: u64,
}

impl Default for RecordConfig {
    fn default() -> Self {
        Self { enabled: false, file_mib: 256 }
    }
}

/// How much of the machine is used, in MiB.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// What `out` may hold.
    pub disk_mib: u64,
    /// What stays free on its file system.
    pub free_mib: u64,
    /// Resident memory at which a session is ended.
    pub memory_mib: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { disk_mib: 4096, free_mib: 256, memory_mib: 1024 }
    }
}

/// The page to watch from, and `/health`.
#[derive(Clone, Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PageConfig {
    /// The address of this machine that it is served at.
    pub bind: IpAddr,
    /// Its port.
    pub port: u16,
    /// The token that visitors show; without one a new one is made at each start where `bind` is not this machine alone.
    pub token: Option<String>,
}

impl Default for PageConfig {
    fn default() -> Self {
        Self { bind: IpAddr::V4(Ipv4Addr::LOCALHOST), port: 7171, token: None }
    }
}

/// Pairing with other agents, as `loopbox run --fleet`.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FleetConfig {
    /// What others are told it is called; by default the agent's name.
    pub name: Option<String>,
    /// Where others reach it.
    pub listen: Option<String>,
    /// Stations and agents to dial.
    pub connect: Vec<String>,
    /// The folder of its keys.
    pub keys: Option<PathBuf>,
}

impl AgentConfig {
    /// Reads the file; paths in it are relative to its folder, and made so.
    ///
    /// # Errors
    /// Names the file, and the line of what is wrong in it.
    pub fn read(path: &Path) -> Result<Self> {
        let text = fs::read_to_string(path).with_context(|| format!("{}: cannot be read", path.display()))?;
        let mut config: Self = toml::from_str(&text).with_context(|| {
            format!(
                "{}: not the file of an agent\nhint: book/src/reference/agent-file.md documents every key",
                path.display()
            )
        })?;
        let folder = path.parent().unwrap_or(Path::new(""));
        config.paths().into_iter().for_each(|path| *path = folder.join(&*path));
        config.check().with_context(|| path.display().to_string())?;
        Ok(config)
    }

    /// All paths in it but the camera's device, which is the system's.
    fn paths(&mut self) -> Vec<&mut PathBuf> {
        let mut paths = vec![&mut self.out];
        paths.extend(self.heartbeat.iter_mut().chain(&mut self.params));
        if let Some(camera) = &mut self.camera {
            paths.push(&mut camera.calibration);
            paths.extend(camera.response.iter_mut().chain(&mut camera.vignette).chain(&mut camera.mask));
        }
        if let Some(recording) = &mut self.recording {
            paths.push(&mut recording.path);
            paths.extend(&mut recording.calibration);
        }
        paths.extend(self.fleet.iter_mut().filter_map(|fleet| fleet.keys.as_mut()));
        paths
    }

    fn check(&self) -> Result<()> {
        match (&self.camera, &self.recording) {
            (None, None) => {
                bail!("there is neither [camera] nor [recording]\nhint: [camera] names the device")
            }
            (Some(_), Some(_)) => {
                bail!("there are both [camera] and [recording]\nhint: take one of them out")
            }
            _ => {}
        }
        let limits = self.limits;
        for (name, value, least) in [
            ("limits.disk_mib", limits.disk_mib, 1),
            ("limits.memory_mib", limits.memory_mib, 32),
            ("record.file_mib", self.record.file_mib, 1),
        ] {
            if value < least {
                bail!("{name} is {value}\nhint: {least} and more can be worked with");
            }
        }
        if self.max_width() < 64 {
            bail!("max_width {} leaves nothing to track\nhint: 640 and more do", self.max_width());
        }
        if let Some(camera) = &self.camera {
            self.camera_args(camera).check()?;
        }
        let parts = [
            (self.camera.is_some() && !cfg!(feature = "camera"), "[camera]", "cameras"),
            (self.page.is_some() && !cfg!(feature = "view"), "[page]", "the page"),
            (self.fleet.is_some() && !cfg!(feature = "fleet"), "[fleet]", "pairing"),
        ];
        if let Some((_, table, what)) = parts.into_iter().find(|(is_missing, ..)| *is_missing) {
            bail!("{table}: this program was built without {what}");
        }
        if let Some(fleet) = &self.fleet
            && fleet.listen.is_none()
            && fleet.connect.is_empty()
        {
            bail!(
                "[fleet]: nobody could be reached\nhint: `listen` says where others reach it, `connect` whom it dials"
            );
        }
        Ok(())
    }

    fn max_width(&self) -> usize {
        let of_camera = self.camera.as_ref().map(|camera| camera.max_width);
        of_camera
            .or(self.recording.as_ref().map(|recording| recording.max_width))
            .unwrap_or(DEFAULT_MAX_WIDTH)
    }

    fn camera_args(&self, camera: &CameraConfig) -> CameraArgs {
        CameraArgs {
            camera: Some(camera.device.clone()),
            fps: camera.fps,
            format: camera.format,
            lock: camera.lock.clone(),
            reconnect: true,
            ..CameraArgs::default()
        }
    }

    /// How the camera is opened, if there is one; at the size of its calibration.
    ///
    /// # Errors
    /// When the calibration cannot be read.
    pub fn camera(&self) -> Result<Option<CameraArgs>> {
        let args = |camera| self.camera_args(camera).for_calibration(Some(&camera.calibration));
        self.camera.as_ref().map(args).transpose()
    }

    /// What is known of the lens.
    pub fn camera_options(&self) -> CameraOptions {
        let camera = self.camera.as_ref();
        let of_recording = self.recording.as_ref().and_then(|recording| recording.calibration.clone());
        CameraOptions {
            calibration: camera.map(|camera| camera.calibration.clone()).or(of_recording),
            response: camera.and_then(|camera| camera.response.clone()),
            vignette: camera.and_then(|camera| camera.vignette.clone()),
            mask: camera.and_then(|camera| camera.mask.clone()),
            max_width: self.max_width(),
            ..CameraOptions::default()
        }
    }

    /// How the agent tracks and maps.
    ///
    /// # Errors
    /// When the parameter file cannot be read; names it and the line.
    pub fn parameters(&self) -> Result<Params> {
        let Some(path) = &self.params else { return Ok(Params::default()) };
        let text = fs::read_to_string(path).with_context(|| format!("{}: cannot be read", path.display()))?;
        toml::from_str(&text).with_context(|| {
            format!(
                "{}: not a parameter file (`loopbox params` prints one with every parameter)",
                path.display()
            )
        })
    }

    /// The file of the heartbeat.
    pub fn heartbeat(&self) -> PathBuf {
        self.heartbeat.clone().unwrap_or_else(|| self.out.join(HEARTBEAT))
    }
}

fn usual_width() -> usize {
    DEFAULT_MAX_WIDTH
}

/// A value as the command line takes it.
fn from_text<'de, D: Deserializer<'de>, T: FromStr<Err = String>>(deserializer: D) -> Result<T, D::Error> {
    String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
}

/// Several of them.
fn from_texts<'de, D: Deserializer<'de>, T: FromStr<Err = String>>(
    deserializer: D,
) -> Result<Vec<T>, D::Error> {
    let texts = Vec::<String>::deserialize(deserializer)?;
    texts.iter().map(|text| text.parse().map_err(serde::de::Error::custom)).collect()
}

#[cfg(test)]
#[path = "config_tests.rs"]
mod tests;
