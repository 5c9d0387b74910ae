//! `loopbox export`: a map in the formats of other tools.

use super::info_map::load_at;
use crate::console::{say, warning};
use anyhow::{bail, ensure};
use geometry::Se3;
use loopbox::placing::board::scale_by_board;
use loopbox::placing::rig::extrinsic;
use loopbox::placing::{Metres, Up, place};
use map::{CloudSelection, DEFAULT_MAX_RELATIVE_VARIANCE, KeyframeId, Map, MapError, StampedPose};
use nalgebra::UnitQuaternion;
use ros2::frames::Axes;
use sources::recording::check_length;
use std::path::{Path, PathBuf};

/// Write a map's cloud, trajectory or posed images in the format of another tool; in metres and upright where asked
#[derive(Clone, Debug, clap::Args)]
pub struct ExportArgs {
    /// The map: a map.mcap, or the folder that `loopbox run` or `loopbox merge` wrote
    #[arg(value_name = "MAP")]
    pub map: PathBuf,
    /// Which files to write.
    #[command(flatten)]
    pub outputs: Outputs,
    /// Leave out points whose variance of inverse depth over its square is larger: 0.01 keeps depths
    /// known to 10 %, 0.0001 those known to 1 %
    #[arg(long, value_name = "V", default_value_t = DEFAULT_MAX_RELATIVE_VARIANCE)]
    pub max_variance: f32,
    /// Of each cube of this edge keep the surest point alone, in the unit that is written
    #[arg(long, value_name = "EDGE")]
    pub voxel: Option<f64>,
    /// In which frame and unit.
    #[command(flatten)]
    pub placing: PlacingArgs,
}

/// In which frame and unit a map is written; as it is unless these say.
#[derive(Clone, Debug, clap::Args)]
pub struct PlacingArgs {
    /// So many metres is a unit of the map
    #[arg(long, value_name = "METRES", group = "unit")]
    pub scale: Option<f64>,
    /// Two keyframes (by their numbers) are so many metres apart: `--distance 12,80=2.4`
    #[arg(long, value_name = "FROM,TO=METRES", group = "unit", value_parser = parse_distance)]
    pub distance: Option<Metres>,
    /// A trajectory in metres of the same times (GPS, odometry, ground truth; TUM format): its unit and its frame are taken
    #[arg(long, value_name = "FILE", group = "unit", conflicts_with = "up")]
    pub track: Option<PathBuf>,
    /// The map of a LiDAR that was on the same robot at the same time, by the same clock: its unit and its frame are taken
    #[arg(long, value_name = "MAP", group = "unit", conflicts_with = "up", requires = "extrinsic")]
    pub lidar: Option<PathBuf>,
    /// Where the camera is on that LiDAR, lidar_from_camera: tx,ty,tz,qx,qy,qz,qw in metres, or a file of these or of the
    /// upper 3×4 of the matrix. A LiDAR has x forward, y left, z up; a camera x right, y down, z forward
    #[arg(long, value_name = "POSE", requires = "lidar", value_parser = extrinsic, allow_hyphen_values = true)]
    pub extrinsic: Option<Se3>,
    /// A board of known size stands in the recording: chessboard:9x6:0.025 (inner corners, side of a square in metres),
    /// charuco:7x5:0.04:0.03[:DICT_4X4_50] (squares, sides of square and marker), aprilgrid:6x6:0.088:0.3 (tags, side, gap as
    /// a share of it); a single AprilTag with number 0 is aprilgrid:1x1:SIDE:1
    #[arg(long, value_name = "BOARD", group = "unit")]
    pub board: Option<calib::Board>,
    /// The axis that points up, by what the cameras say of gravity; as it is, the world is that of the first camera: y down
    #[arg(long, value_enum)]
    pub up: Option<Up>,
}

/// `12,80=2.4`
fn parse_distance(text: &str) -> anyhow::Result<Metres> {
    let parts = text.split_once('=').and_then(|(pair, metres)| Some((pair.split_once(',')?, metres)));
    let parsed = parts.and_then(|((from, to), metres)| {
        let id = |text: &str| text.trim().parse().ok().map(KeyframeId);
        Some(Metres::Distance { from: id(from)?, to: id(to)?, metres: metres.trim().parse().ok()? })
    });
    parsed.ok_or_else(|| anyhow::anyhow!("expected two numbers of keyframes and metres, as in `12,80=2.4`"))
}

impl PlacingArgs {
    /// What tells the unit of `map`.
    fn metres(&self, map: &Map) -> anyhow::Result<Option<Metres>> {
        let max_diff = eval::DEFAULT_MAX_DIFF;
        let by_track = self.track.as_ref().map(|file| Metres::Track { file: file.clone(), max_diff });
        let by_lidar = self.lidar.clone().zip(self.extrinsic);
        let by_lidar = by_lidar.map(|(map, lidar_from_camera)| Metres::Lidar { map, lidar_from_camera });
        let given = self.scale.map(Metres::Scale).or(self.distance.clone()).or(by_track).or(by_lidar);
        Ok(given.or(self.by_board(map)?))
    }

    /// How the axes of the map's world lie, once it is placed.
    fn axes(&self, map: &Map) -> Axes {
        let own = map.agents.values().next().map_or(Axes::Body, |info| Axes::of(&info.sensor));
        match self.up {
            Some(Up::Z) => Axes::Body,
            Some(Up::Y) => Axes::Graphics,
            // A track and a LiDAR have frames of their own, which stay as they are.
            None if self.track.is_some() || self.lidar.is_some() => Axes::Body,
            None => own,
        }
    }

    fn by_board(&self, map: &Map) -> anyhow::Result<Option<Metres>> {
        let Some(board) = &self.board else { return Ok(None) };
        let found = scale_by_board(board, &loopbox::calibrating::sightings(map, board)?)?;
        say!("{board}: {found}");
        Ok(Some(Metres::Scale(found.metres)))
    }
}

/// The files to write; one at least.
#[derive(Clone, Debug, clap::Args)]
#[group(required = true, multiple = true)]
pub struct Outputs {
    /// Point cloud as binary PLY: x y z intensity confidence red green blue, and of several agents agent
    #[arg(long, value_name = "FILE")]
    pub ply: Option<PathBuf>,
    /// Point cloud as binary PCD: x y z intensity confidence rgb, and of several agents label
    #[arg(long, value_name = "FILE")]
    pub pcd: Option<PathBuf>,
    /// Point cloud as LAS, or as LAZ where FILE ends in .laz: with intensity and colours
    #[arg(long, value_name = "FILE")]
    pub las: Option<PathBuf>,
    /// Points and trajectories as binary glTF, for browsers, phones and Blender: --up y lets them stand upright
    #[arg(long, value_name = "FILE")]
    pub glb: Option<PathBuf>,
    /// Trajectory as TUM text: timestamp tx ty tz qx qy qz qw; of several agents a file each, FILE with the
    /// agent's name at the end of its own
    #[arg(long, value_name = "FILE")]
    pub tum: Option<PathBuf>,
    /// Trajectory as KITTI text: the upper 3×4 of each pose, row by row; of several agents as --tum
    #[arg(long, value_name = "FILE")]
    pub kitti: Option<PathBuf>,
    /// The map itself as a whole file, with everything viewers show: mends the file of a killed run. Of one agent in metres
    /// it says so, and what it is merged with gets metres too
    #[arg(long, value_name = "FILE")]
    pub mcap: Option<PathBuf>,
    /// The report: one HTML file that shows the map without a network, as a run's does. What frames took is not in a map, nor is
    /// it in the file
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// A bag for ROS 2 (MCAP): trajectories as /tf and odometry, the points of each keyframe as PointCloud2, thinned by --voxel
    /// as one cloud; x forward, y left, z up, level with --up z
    #[arg(long, value_name = "FILE")]
    pub ros2: Option<PathBuf>,
    /// Folder of a COLMAP project: undistorted images, and cameras, poses and sparse points with their tracks as text
    #[arg(long, value_name = "DIR")]
    pub colmap: Option<PathBuf>,
    /// Folder for nerfstudio: undistorted images, transforms.json and sparse points to begin splats from
    #[arg(long, value_name = "DIR")]
    pub nerfstudio: Option<PathBuf>,
}

impl Outputs {
    /// Refuses names that say another form than the option does.
    fn check_names(&self) -> anyhow::Result<()> {
        let forms = [
            ("--ply", &self.ply, &["ply"][..]),
            ("--pcd", &self.pcd, &["pcd"]),
            ("--las", &self.las, &["las", "laz"]),
            ("--glb", &self.glb, &["glb"]),
            ("--mcap", &self.mcap, &["mcap"]),
            ("--ros2", &self.ros2, &["mcap"]),
            ("--report", &self.report, &["html"]),
        ];
        for path in [&self.tum, &self.kitti, &self.colmap, &self.nerfstudio].into_iter().flatten() {
            check_length(path)?;
        }
        for (option, path, own) in forms {
            let Some(path) = path else { continue };
            check_length(path)?;
            let ending = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
            let other = forms.iter().find(|(.., endings)| endings.contains(&&*ending));
            if let Some((right, ..)) = other.filter(|_| !own.contains(&&*ending)) {
                bail!("{}: {option} does not write .{ending}\nhint: {right} does", path.display());
            }
        }
        Ok(())
    }
}

/// A factor with as many figures as a measured length has at most.
fn figures(factor: f64) -> String {
    const FIGURES: i32 = 6;
    let decimals = FIGURES - 1 - factor.abs().log10().floor() as i32;
    let power = 10f64.powi(decimals);
    format!("{}", (factor * power).round() / power)
}

/// Runs `loopbox export`.
///
/// # Errors
/// When the map cannot be loaded, a file cannot be written or the bound is not a positive number.
pub fn run(args: &ExportArgs) -> anyhow::Result<()> {
    ensure!(args.max_variance > 0.0, "--max-variance is {}; give a number above 0", args.max_variance);
    ensure!(args.voxel.is_none_or(|edge| edge > 0.0), "--voxel must be a length above 0");
    args.outputs.check_names()?;
    let mut map = load_at(&args.map)?;
    let metres = args.placing.metres(&map)?;
    let growth = place(&mut map, metres.as_ref(), args.placing.up)?;
    if metres.is_some() || growth != 1.0 {
        say!("lengths are {} times those of the map", figures(growth));
    }
    if map.keyframes.values().all(|keyframe| keyframe.semi_dense.is_empty() && keyframe.scan.is_none()) {
        warning!("{}: no keyframe has depth: clouds of it are empty", args.map.display());
    }
    let selection = CloudSelection { voxel: args.voxel, ..args.max_variance.into() };
    write_clouds(&args.outputs, &map, selection)?;
    if let Some(path) = &args.outputs.glb {
        let points = map::save_glb(path, &map, selection, gltf_from(args.placing.axes(&map)))?;
        say!("{}: {points} points", path.display());
    }
    if let Some(path) = &args.outputs.ros2 {
        write_bag(path, &map, args.placing.axes(&map), selection)?;
    }
    if let Some(path) = &args.outputs.tum {
        write_trajectories(path, &map, |path, trajectory| map::save_tum(path, trajectory))?;
    }
    if let Some(path) = &args.outputs.kitti {
        write_trajectories(path, &map, |path, trajectory| map::save_kitti(path, trajectory))?;
    }
    if let Some(path) = &args.outputs.mcap {
        map::save_map(path, &map)?;
        say!("{}: {} keyframes", path.display(), map.keyframes.len());
    }
    if let Some(path) = &args.outputs.report {
        loopbox::write_report(path, &map)?;
        say!("{}: {} keyframes", path.display(), map.keyframes.len());
    }
    if let Some(folder) = &args.outputs.colmap {
        let (images, points) = map::save_colmap(folder, &map)?;
        say!("{}: {images} images, {points} points", folder.display());
    }
    if let Some(folder) = &args.outputs.nerfstudio {
        let (images, points) = map::save_nerfstudio(folder, &map)?;
        say!("{}: {images} images, {points} points", folder.display());
    }
    Ok(())
}

/// Writes the trajectory of each agent with `save`: of one into `path`, of several into files beside it that
/// have their agents' names at the end of theirs.
fn write_trajectories(
    path: &Path,
    map: &Map,
    save: impl Fn(&Path, &[StampedPose]) -> Result<(), MapError>,
) -> anyhow::Result<()> {
    for (agent, label) in map.agent_labels() {
        let path = if map.agents.len() > 1 { with_label(path, &label) } else { path.to_owned() };
        let trajectory = map.trajectory_of(agent);
        save(&path, &trajectory)?;
        say!("{}: {} poses", path.display(), trajectory.len());
    }
    Ok(())
}

/// The turn from a world of these axes to glTF's, which has them as computer graphics do.
fn gltf_from(world: Axes) -> UnitQuaternion<f64> {
    Axes::Graphics.body_from_own().inverse() * world.body_from_own()
}

/// Writes the bag for ROS 2.
fn write_bag(path: &Path, map: &Map, world: Axes, selection: CloudSelection) -> anyhow::Result<()> {
    let counts = map::write_atomically(path, |out| ros2::bag::write_bag(out, map, world, selection));
    let counts = counts.map_err(|source| MapError::write(path, source))?;
    say!("{}: {} poses, {} points in {} clouds", path.display(), counts.poses, counts.points, counts.clouds);
    Ok(())
}

/// `folder/name-label.ext` for `folder/name.ext`.
fn with_label(path: &Path, label: &str) -> PathBuf {
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(format!("-{label}"));
    if let Some(extension) = path.extension() {
        name.push(".");
        name.push(extension);
    }
    path.with_file_name(name)
}

/// Writes the clouds that are asked for.
fn write_clouds(outputs: &Outputs, map: &Map, selection: CloudSelection) -> anyhow::Result<()> {
    if let Some(path) = &outputs.ply {
        let points = map::save_ply(path, map, selection)?;
        say!("{}: {points} points", path.display());
    }
    if let Some(path) = &outputs.pcd {
        let points = map::save_pcd(path, map, selection)?;
        say!("{}: {points} points", path.display());
    }
    if let Some(path) = &outputs.las {
        let points = map::save_las(path, map, selection)?;
        say!("{}: {points} points", path.display());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_two_keyframes_and_metres() {
        let (from, to) = (KeyframeId(12), KeyframeId(80));
        assert_eq!(parse_distance("12,80=2.4").unwrap(), Metres::Distance { from, to, metres: 2.4 });
        for bad in ["", "12=2.4", "12,80", "a,80=2", "12,80=x"] {
            assert!(parse_distance(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn what_is_up_is_up_in_gltf() {
        let up = [
            (Axes::Optical, [0.0, -1.0, 0.0]),
            (Axes::Body, [0.0, 0.0, 1.0]),
            (Axes::Graphics, [0.0, 1.0, 0.0]),
        ];
        for (world, up) in up {
            let turned = gltf_from(world) * nalgebra::Vector3::from(up);
            assert!((turned - nalgebra::Vector3::y()).norm() < 1e-9, "{world:?}");
        }
    }

    #[test]
    fn an_agents_name_ends_that_of_its_file() {
        for (path, expected) in
            [("out/path.txt", "out/path-yard.txt"), ("path", "path-yard"), ("a.b/c.d.e", "a.b/c.d-yard.e")]
        {
            assert_eq!(with_label(Path::new(path), "yard"), Path::new(expected));
        }
    }
}
