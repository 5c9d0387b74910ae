//! The types of the messages: what ROS 2 calls them, and their definitions as a bag carries them, so that readers need no
//! ROS to read it.

/// A type of messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageType {
    /// `package/msg/Name`.
    pub name: &'static str,
    /// Its own fields, and those of the types among them.
    fields: &'static str,
    parts: &'static [Part],
}

/// A type among the fields of another: `package/Name` and its fields.
type Part = (&'static str, &'static str);

/// `sensor_msgs/msg/PointCloud2`.
pub const POINT_CLOUD2: MessageType = MessageType {
    name: "sensor_msgs/msg/PointCloud2",
    fields: "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\n\
             uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n",
    parts: &[HEADER, TIME, POINT_FIELD],
};

/// `nav_msgs/msg/Odometry`.
pub const ODOMETRY: MessageType = MessageType {
    name: "nav_msgs/msg/Odometry",
    fields: "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n\
             geometry_msgs/TwistWithCovariance twist\n",
    parts: &[
        HEADER,
        TIME,
        POSE_WITH_COVARIANCE,
        POSE,
        POINT,
        QUATERNION,
        TWIST_WITH_COVARIANCE,
        TWIST,
        VECTOR3,
    ],
};

/// `tf2_msgs/msg/TFMessage`.
pub const TF_MESSAGE: MessageType = MessageType {
    name: "tf2_msgs/msg/TFMessage",
    fields: "geometry_msgs/TransformStamped[] transforms\n",
    parts: &[TRANSFORM_STAMPED, HEADER, TIME, TRANSFORM, VECTOR3, QUATERNION],
};

const HEADER: Part = ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n");
const TIME: Part = ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n");
const POINT_FIELD: Part = (
    "sensor_msgs/PointField",
    "uint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\nuint8 UINT32=6\nuint8 FLOAT32=7\n\
     uint8 FLOAT64=8\nstring name\nuint32 offset\nuint8 datatype\nuint32 count\n",
);
const POSE_WITH_COVARIANCE: Part =
    ("geometry_msgs/PoseWithCovariance", "geometry_msgs/Pose pose\nfloat64[36] covariance\n");
const POSE: Part =
    ("geometry_msgs/Pose", "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n");
const POINT: Part = ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n");
const QUATERNION: Part = ("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n");
const TWIST_WITH_COVARIANCE: Part =
    ("geometry_msgs/TwistWithCovariance", "geometry_msgs/Twist twist\nfloat64[36] covariance\n");
const TWIST: Part = ("geometry_msgs/Twist", "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n");
const VECTOR3: Part = ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n");
const TRANSFORM_STAMPED: Part = (
    "geometry_msgs/TransformStamped",
    "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n",
);
const TRANSFORM: Part =
    ("geometry_msgs/Transform", "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n");

impl MessageType {
    /// The definition with those of all types in it, as MCAP's schema encoding `ros2msg` has it.
    pub fn definition(&self) -> String {
        let mut text = self.fields.to_owned();
        for (name, fields) in self.parts {
            text += &"=".repeat(80);
            text += &format!("\nMSG: {name}\n{fields}");
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whatever a field is of is defined, once, and nothing else is.
    #[test]
    fn definitions_are_complete() {
        const PLAIN: [&str; 7] = ["bool", "uint8", "int32", "uint32", "float64", "string", ""];
        for message in [POINT_CLOUD2, ODOMETRY, TF_MESSAGE] {
            let fields = message.parts.iter().map(|(_, fields)| *fields).chain([message.fields]);
            let mut used: Vec<&str> = fields
                .flat_map(str::lines)
                .filter_map(|line| line.split([' ', '[']).next())
                .filter(|kind| !PLAIN.contains(kind))
                .collect();
            used.sort_unstable();
            used.dedup();
            let mut defined: Vec<&str> = message.parts.iter().map(|(name, _)| *name).collect();
            defined.sort_unstable();
            assert_eq!(used, defined, "{}", message.name);
            assert_eq!(message.definition().matches("\nMSG: ").count(), defined.len());
        }
    }
}
