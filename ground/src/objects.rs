//! Object storage: a folder that all machines see, or a bucket of S3-compatible storage (`s3://BUCKET/PREFIX`, its keys, region
//! and endpoint from `AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`, `AWS_REGION`, `AWS_ENDPOINT`, `AWS_ALLOW_HTTP`).

use object_store::ObjectStore;
use object_store::path::Path;
use url::Url;

/// The storage at `address`, a folder (which is made) or a URL, and the path in it.
///
/// # Errors
/// A sentence: it is neither.
pub(crate) fn open(address: &str) -> Result<(Box<dyn ObjectStore>, Path), String> {
    let url = if address.contains("://") {
        Url::parse(address).map_err(|error| error.to_string())?
    } else {
        let made = std::fs::create_dir_all(address).and_then(|()| std::fs::canonicalize(address));
        let folder = made.map_err(|error| error.to_string())?;
        Url::from_directory_path(folder).map_err(|()| "not a folder".to_owned())?
    };
    // For https: who asks first chooses, and there is one to choose.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let settings = std::env::vars_os();
    let settings = settings.filter_map(|(key, value)| Some((key.into_string().ok()?, value.into_string().ok()?)));
    // It takes a plain TOKEN or REGION for its own, too.
    let settings = settings.filter(|(key, _)| key.starts_with("AWS_"));
    object_store::parse_url_opts(&url, settings).map_err(|error| error.to_string())
}
