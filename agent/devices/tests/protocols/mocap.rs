//! Motion capture: there and back, hidden bodies, cut datagrams.

use nalgebra::{UnitQuaternion, Vector3};
use plumbline_devices::protocol::{natnet, vicon};
use plumbline_devices::reading::PoseReading;

fn pose() -> PoseReading {
    PoseReading {
        position_m: Vector3::new(1.5, -0.25, 0.875),
        attitude: UnitQuaternion::from_euler_angles(0.2, -0.4, 2.5),
    }
}

fn same(pose: &PoseReading, other: &PoseReading, within: f64) -> bool {
    (pose.position_m - other.position_m).amax() < within && pose.attitude.angle_to(&other.attitude) < within
}

#[test]
fn vicon_objects_are_found_by_name_among_others() {
    let mut datagram = vicon::encode(77, "other", &PoseReading { position_m: Vector3::x(), ..pose() });
    let own = vicon::encode(77, "iris-1", &pose());
    datagram[4] = 2;
    datagram.extend(&own[5..]);
    let (frame, found) = vicon::decode(&datagram, "iris-1").unwrap();
    assert!(frame == 77 && same(&found.unwrap(), &pose(), 1e-9), "{found:?}");
    assert_eq!(vicon::decode(&datagram, "iris").unwrap(), (77, None), "a name is whole");
    for length in 0..datagram.len() {
        let cut = vicon::decode(&datagram[..length], "iris-1");
        assert!(cut.is_err(), "{length} bytes: {cut:?}");
    }
    let hidden = PoseReading { position_m: Vector3::zeros(), attitude: UnitQuaternion::identity() };
    assert_eq!(vicon::decode(&vicon::encode(1, "iris-1", &hidden), "iris-1"), Ok((1, None)));
}

#[test]
fn natnet_bodies_are_found_in_every_version_read() {
    for version in [(3, 0), (3, 1), (4, 0), (4, 1)] {
        let datagram = natnet::encode(42, version, 5, &pose(), true, 0.5);
        let (frame, found) = natnet::decode(&datagram, version, 5).unwrap().unwrap();
        assert!(frame == 42 && same(&found.unwrap(), &pose(), 1e-6), "{version:?} {found:?}");
        assert_eq!(natnet::decode(&datagram, version, 6), Ok(Some((42, None))));
        let lost = natnet::encode(43, version, 5, &pose(), false, 0.5);
        assert_eq!(natnet::decode(&lost, version, 5), Ok(Some((43, None))), "not tracked");
        // Up to the last byte of the body in the shortest layout.
        for length in 0..58 {
            assert!(!matches!(natnet::decode(&datagram[..length], version, 5), Ok(Some((_, Some(_))))), "{length}");
        }
    }
    let info = natnet::encode_server_info((4, 1));
    assert_eq!((natnet::decode_server_info(&info), natnet::decode(&info, (4, 1), 5)), (Some((4, 1)), Ok(None)));
    assert_eq!(natnet::decode_server_info(&natnet::encode_connect()), None);
    assert!(natnet::is_connect(&natnet::encode_connect()) && !natnet::is_connect(&info) && !natnet::is_connect(&[0]));
}
