//! Identities and peers in folders of their own.

use super::*;

#[test]
fn an_identity_is_made_once_and_its_key_is_private() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let made = load_or_create(&folder.path().join("a")).unwrap();
    let again = load_or_create(&folder.path().join("a")).unwrap();
    assert_eq!(made.fingerprint(), again.fingerprint());
    let other = load_or_create(&folder.path().join("b")).unwrap();
    assert_ne!(made.fingerprint(), other.fingerprint());
    let mode = fs::metadata(folder.path().join("a/key.pem")).unwrap().permissions().mode();
    assert_eq!(mode & 0o077, 0, "key.pem has mode {mode:o}");
    assert_eq!(Fingerprint::parse(&made.fingerprint().to_string()).unwrap(), made.fingerprint());
}

#[test]
fn peers_come_and_go_with_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let me = load_or_create(folder.path()).unwrap();
    let peer = Fingerprint([7; 32]);
    assert_eq!(me.peer(peer), None);
    me.trust(peer, "bench\nground").unwrap();
    me.trust(peer, "twice").unwrap();
    assert_eq!(me.peer(peer).as_deref(), Some("bench ground"));
    let text = fs::read_to_string(folder.path().join("peers")).unwrap();
    assert_eq!(text.lines().count(), 1);
    // A broken line does not lock out the good one.
    fs::write(folder.path().join("peers"), format!("nonsense\n# note\n{text}")).unwrap();
    std::thread::sleep(Duration::from_millis(110));
    assert_eq!(me.peer(peer).as_deref(), Some("bench ground"));
    fs::write(folder.path().join("peers"), "").unwrap();
    std::thread::sleep(Duration::from_millis(110));
    assert_eq!(me.peer(peer), None, "a line taken out ends the trust");
    me.trust(peer, "bench").unwrap();
    me.trust(Fingerprint([8; 32]), "rig").unwrap();
    assert_eq!((me.revoke("nobody").unwrap(), me.revoke("bench").unwrap()), (0, 1));
    assert_eq!((me.peer(peer), me.peer(Fingerprint([8; 32])).as_deref()), (None, Some("rig")));
    assert_eq!(me.revoke(&Fingerprint([8; 32]).to_string()).unwrap(), 1);
    let before = me.fingerprint();
    let after = rotate(folder.path()).unwrap().fingerprint();
    assert!(before != after && load_or_create(folder.path()).unwrap().fingerprint() == after);
}

#[test]
fn what_a_power_cut_left_of_a_new_identity_is_made_anew() {
    let folder = tempfile::tempdir().unwrap();
    let made = load_or_create(folder.path()).unwrap().fingerprint();
    let there = |name: &str| folder.path().join(name).exists();
    // While it was made, or rotated: the certificate is the last to come, and the first to go.
    fs::remove_file(folder.path().join("cert.pem")).unwrap();
    let again = load_or_create(folder.path()).unwrap().fingerprint();
    assert!(again != made && load_or_create(folder.path()).unwrap().fingerprint() == again);
    // A key that cannot be moved stands for a power cut before its turn.
    fs::create_dir(folder.path().join("key.pem.old")).unwrap();
    rotate(folder.path()).unwrap_err();
    assert!(there("key.pem") && there("cert.pem.old") && !there("cert.pem"));
    assert_ne!(load_or_create(folder.path()).unwrap().fingerprint(), again);
}

#[test]
fn a_name_belongs_to_one_peer() {
    let folder = tempfile::tempdir().unwrap();
    let me = load_or_create(folder.path()).unwrap();
    let [first, second] = [Fingerprint([7; 32]), Fingerprint([8; 32])];
    me.enrol(first, "iris-1").unwrap();
    assert!(matches!(me.enrol(second, "iris-1"), Err(IdentityError::Taken { holder, .. }) if holder == first));
    assert_eq!(me.peer(second), None);
    me.enrol(first, "iris-9").unwrap();
    me.enrol(second, "iris-1").unwrap();
    assert_eq!((me.revoke("iris-1").unwrap(), me.peer(first).as_deref()), (1, Some("iris-9")));
}

#[test]
fn a_folder_that_vanished_is_not_an_empty_one() {
    let folder = tempfile::tempdir().unwrap();
    let (here, away) = (folder.path().join("identity"), folder.path().join("away"));
    let me = load_or_create(&here).unwrap();
    let [peer, stranger] = [Fingerprint([7; 32]), Fingerprint([8; 32])];
    me.enrol(peer, "iris-1").unwrap();
    let look = |peer| {
        std::thread::sleep(Duration::from_secs(1) / RELOADS_PER_SECOND);
        me.peer(peer)
    };
    fs::rename(&here, &away).unwrap();
    assert_eq!(look(peer).as_deref(), Some("iris-1"), "the folder is away");
    fs::create_dir(&here).unwrap();
    assert_eq!(look(peer).as_deref(), Some("iris-1"), "an empty mount point is in its place");
    assert!(me.trouble().unwrap().contains("vanished"));
    assert!(me.enrol(stranger, "iris-2").is_err() && me.revoke("iris-1").is_err(), "nothing is written there");
    fs::remove_dir(&here).unwrap();
    fs::rename(&away, &here).unwrap();
    fs::remove_file(here.join("peers")).unwrap();
    assert_eq!((look(peer), me.trouble()), (None, None), "a file taken out of its folder ends the trust");
}

#[test]
fn bad_fingerprints_and_files_are_named() {
    assert!(Fingerprint::parse("sha256:12").unwrap_err().to_string().contains("sha256:12"));
    assert!(Fingerprint::parse(&"zz".repeat(32)).is_err());
    assert!(Fingerprint::parse(&"é".repeat(32)).is_err());
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("cert.pem"), "no certificate").unwrap();
    fs::write(folder.path().join("key.pem"), "no key").unwrap();
    assert!(load_or_create(folder.path()).unwrap_err().to_string().contains("cert.pem"));
}
