//! Registers: the data sheets' own examples, and there and back.

use nalgebra::Vector3;
use plumbline_devices::protocol::bno055::{self, UartReplies, UartReply, UartRequest, UartRequests};
use plumbline_devices::protocol::mongoose::{self, Mongoose, MongooseReading};
use plumbline_devices::protocol::pressure::{bmp280, ms5611};
use plumbline_devices::protocol::tfmini::{self, TfMini};
use plumbline_devices::protocol::{ina, invensense, pca9685};
use plumbline_devices::reading::{BarometerReading, ImuReading, Reading};

use super::read;

#[test]
fn ms5611_as_its_data_sheet_computes() {
    // Data sheet, figure 2: typical values.
    let prom = [0, 40_127, 36_924, 23_317, 23_282, 33_464, 28_312, 0];
    let reading = ms5611::compensate(&prom, 9_085_466, 8_569_150);
    assert_eq!((reading.pressure_pa, reading.temperature_c), (100_009.0, 20.07));
    // AN520, its example: the checksum is 0xB.
    let prom = [0x3132, 0x3334, 0x3536, 0x3738, 0x3940, 0x4142, 0x4344, 0x4500];
    assert_eq!(ms5611::crc4(&prom), 0xB);
    let mut marked = prom;
    marked[7] |= 0xB;
    ms5611::check(&marked).unwrap();
    marked[2] ^= 0x10;
    assert!(ms5611::check(&marked).is_err());
    assert!(ms5611::check(&[0; 8]).is_err(), "a bus that is held low");
    // What the wire rig sends is found again, below 20 °C too, where the second order begins.
    let prom = [0, 40_127, 36_924, 23_317, 23_282, 33_464, 28_312, 0];
    for (pressure_pa, temperature_c) in [(101_325.0, 22.5), (99_123.0, 31.0), (100_960.0, 12.0)] {
        let [raw_p, raw_t] = ms5611::encode(&prom, &BarometerReading { pressure_pa, temperature_c });
        let back = ms5611::compensate(&prom, raw_p, raw_t);
        assert_eq!(back.pressure_pa, pressure_pa);
        assert!((back.temperature_c - temperature_c).abs() < 0.011, "{back:?}");
    }
}

#[test]
fn bmp280_as_its_data_sheet_computes() {
    // Data sheet 3.12: the example of the compensation.
    let words: [i32; 12] = [27_504, 26_435, -1_000, 36_477, -10_685, 3_024, 2_855, 140, -7, 15_500, -14_600, 6_000];
    let mut calibration = [0; 24];
    for (pair, word) in calibration.chunks_mut(2).zip(words) {
        pair.copy_from_slice(&(word as u16).to_le_bytes());
    }
    let raw = |value: u32| [(value >> 12) as u8, (value >> 4) as u8, (value << 4) as u8];
    let data = [raw(415_148), raw(519_888)].concat().try_into().unwrap();
    let reading = bmp280::compensate(&calibration, &data);
    assert!((reading.temperature_c - 25.08).abs() < 0.005, "{reading:?}");
    assert!((reading.pressure_pa - 100_653.27).abs() < 0.2, "{reading:?}");
    for (pressure_pa, temperature_c) in [(101_325.0, 22.5), (99_123.0, 31.0)] {
        let sent = bmp280::encode(&calibration, &BarometerReading { pressure_pa, temperature_c });
        let back = bmp280::compensate(&calibration, &sent);
        // A step of either register is 0.3 Pa and 0.005 °C at most.
        assert!((back.pressure_pa - pressure_pa).abs() < 0.3, "{back:?}");
        assert!((back.temperature_c - temperature_c).abs() < 0.005, "{back:?}");
    }
}

#[test]
fn voltages_and_pulses() {
    // INA219: 0x5D98 is 11.98 V (data sheet, table of the example); INA226: 0x2570 is 11.98 V.
    assert!((ina::ina219_v(0x5D98).unwrap() - 11.98).abs() < 0.005);
    assert_eq!(ina::ina219_v(0x5D99), None, "overflow");
    assert!((ina::ina219_v(ina::encode_ina219(14.8)).unwrap() - 14.8).abs() < 2.1e-3);
    assert!((ina::ina226_v(0x2570) - 11.98).abs() < 1e-9);
    assert!((ina::ina226_v(ina::encode_ina226(14.8)) - 14.8).abs() < 1e-3);
    // Data sheet 7.3.5: 200 Hz is a divider of 30.
    assert_eq!(pca9685::prescale(200.0), 30);
    let prescale = pca9685::prescale(400.0);
    for width_us in [1000.0, 1234.0, 2000.0] {
        let back = pca9685::decode_channel(pca9685::encode_channel(width_us, prescale), prescale);
        assert!((back - width_us).abs() < 0.4, "{width_us}: {back}");
    }
    assert_eq!(pca9685::decode_channel([0, 0, 0xff, 0x1f], prescale), 0.0, "full off");
}

fn imu() -> ImuReading {
    ImuReading {
        gyro_radps: Vector3::new(0.5, -1.25, 3.0),
        accel_mps2: Vector3::new(0.3, -9.81, 4.0),
        mag_ut: Some(Vector3::new(20.0, -3.5, 41.0)),
        temperature_c: 31.0,
    }
}

#[test]
fn bno055_registers_there_and_back_within_their_resolution() {
    let back = bno055::decode_data(&bno055::encode_data(&imu()), 31.0);
    assert!((back.gyro_radps - imu().gyro_radps).amax() <= 0.0625_f64.to_radians());
    assert!((back.accel_mps2 - imu().accel_mps2).amax() <= 0.005 + 1e-12);
    assert!((back.mag_ut.unwrap() - imu().mag_ut.unwrap()).amax() <= 0.04);
    // 1 g along z, 16 LSB for a degree a second (data sheet 3.6.4).
    let mut data = [0; 18];
    data[4..6].copy_from_slice(&981_i16.to_le_bytes());
    data[12..14].copy_from_slice(&(-16_i16).to_le_bytes());
    let known = bno055::decode_data(&data, 0.0);
    assert!((known.accel_mps2.z - 9.81).abs() < 1e-12 && (known.gyro_radps.x + 1_f64.to_radians()).abs() < 1e-12);
}

#[test]
fn bno055_uart_answers_and_requests() {
    let expecting = |expected: usize| UartReplies { expected };
    let frames = read(expecting(2), &[0xBB, 2, 7, 8, 0xEE, 1, 0xEE, 7], 1);
    let Ok(UartReply::Data(data)) = frames[0] else { panic!("{frames:?}") };
    assert_eq!(data[..2], [7, 8]);
    assert_eq!(frames[1], Ok(UartReply::Written));
    assert_eq!(frames[2].unwrap_err().to_string(), "the device reports UART status 7");
    let sent = [&bno055::encode_read(8, 18)[..], &[0xAA, 0, 0x3D, 1, 7]].concat();
    let heard: Vec<_> = read(UartRequests, &sent, 3).into_iter().map(Result::unwrap).collect();
    assert_eq!(heard, [UartRequest::Read(8, 18), UartRequest::Write(0x3D, 7)]);
}

#[test]
fn mongoose_frames_there_and_back_and_other_versions_refused() {
    let barometer = BarometerReading { pressure_pa: 101_325.0, temperature_c: 31.0 };
    let sent = MongooseReading { sequence: 200, stamp_us: 4_000_000_000, imu: imu(), barometer };
    let mut frame = mongoose::encode(&sent);
    let back = read(Mongoose, &frame, 5)[0].unwrap();
    assert_eq!((back.sequence, back.stamp_us, back.barometer), (200, 4_000_000_000, barometer));
    assert!((back.imu.gyro_radps - imu().gyro_radps).amax() <= 0.035_f64.to_radians() + 1e-12);
    assert!((back.imu.accel_mps2 - imu().accel_mps2).amax() <= 0.5 * 4e-3 * 9.81 + 1e-12);
    frame[2] = 2;
    let check = plumbline_devices::protocol::ubx::fletcher(&frame[2..32]);
    frame[32..].copy_from_slice(&check);
    let refused = read(Mongoose, &frame, 34)[0].unwrap_err().to_string();
    assert_eq!(refused, "frame version 2 is not 1");
}

#[test]
fn tfmini_distances_and_codes() {
    // 59 59, 123 cm, strength 1000, 25 °C.
    let bytes = [0x59, 0x59, 0x7B, 0x00, 0xE8, 0x03, 0xC8, 0x08, 0xE8];
    assert_eq!(tfmini::encode(1.23, 1000, 25.0), bytes);
    let Ok(Reading::Range(range)) = read(TfMini, &bytes, 9)[0] else { panic!() };
    assert!((range.distance_m - 1.23).abs() < 1e-12);
    let weak = read(TfMini, &tfmini::encode(1.0, 50, 20.0), 9)[0].unwrap_err();
    assert_eq!(weak.to_string(), "strength 50 is not 100 to 65534");
    let dark = read(TfMini, &tfmini::encode(655.35, 500, 20.0), 9)[0].unwrap_err();
    assert_eq!(dark.to_string(), "the device reports distance code 65535");
}

#[test]
fn an_mpu_counts_as_its_register_map_says() {
    let icm = invensense::chip(0x12).unwrap();
    // ±16 g: 2048 counts for 1 g; ±2000 °/s: 164 for 10 °/s; 25 °C at zero.
    let counts = [2048_i16, -1024, 0, 0, 164, 0, -164];
    let data: Vec<u8> = counts.iter().flat_map(|count| count.to_be_bytes()).collect();
    let data: [u8; 14] = data.try_into().unwrap();
    let reading = invensense::decode(&data, &icm);
    assert!((reading.accel_mps2 - Vector3::new(9.806_65, -4.903_325, 0.0)).amax() < 1e-9, "{reading:?}");
    let ten = 10_f64.to_radians();
    assert!((reading.gyro_radps - Vector3::new(ten, 0.0, -ten)).amax() < 1e-9, "{reading:?}");
    assert!((reading.temperature_c - 25.0).abs() < 1e-9 && reading.mag_ut.is_none(), "{reading:?}");
    assert_eq!(invensense::encode(&reading, &icm), data);
    // An MPU-6050 has 36.53 °C there.
    let mpu = invensense::decode(&data, &invensense::chip(0x68).unwrap());
    assert!((mpu.temperature_c - 36.53).abs() < 1e-9, "{mpu:?}");
    assert_eq!(invensense::chip(0xEA), None, "an ICM-20948 has another map");
}
