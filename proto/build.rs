//! Compiles the schema with protox: no protoc needed.
use std::{
    collections::{BTreeMap, BTreeSet},
    env,
    fmt::Write as _,
    fs,
    path::PathBuf,
};

use prost::Message as _;
use protox::prost_reflect::prost_types::{DescriptorProto, FileDescriptorSet};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo:rerun-if-changed=schema");
    let mut files: Vec<PathBuf> =
        fs::read_dir("schema/plumbline/v1")?.map(|entry| entry.map(|e| e.path())).collect::<Result<_, _>>()?;
    files.sort();
    let descriptors = protox::compile(&files, ["schema"])?;
    // Embedded in every flight file: without its comments.
    let mut embedded = descriptors.clone();
    embedded.file.iter_mut().for_each(|file| file.source_code_info = None);
    let out = PathBuf::from(env::var("OUT_DIR")?);
    fs::write(out.join("descriptors.bin"), embedded.encode_to_vec())?;
    let mut arms = String::new();
    for file in &embedded.file {
        for message in &file.message_type {
            let name = format!("{}.{}", file.package(), message.name());
            fs::write(out.join(format!("{name}.bin")), describing(&embedded, &name).encode_to_vec())?;
            writeln!(arms, "{name:?} => include_bytes!(concat!(env!(\"OUT_DIR\"), \"/{name}.bin\")),")?;
        }
    }
    fs::write(out.join("describing.rs"), format!("match message {{\n{arms}_ => FILE_DESCRIPTOR_SET,\n}}"))?;
    prost_build::Config::new().compile_fds(descriptors)?;
    Ok(())
}

/// What of `all` describes one message: it, and every type that a field of it leads to.
fn describing(all: &FileDescriptorSet, message: &str) -> FileDescriptorSet {
    let messages: BTreeMap<String, &DescriptorProto> = all
        .file
        .iter()
        .flat_map(|file| {
            file.message_type.iter().map(|message| (format!("{}.{}", file.package(), message.name()), message))
        })
        .collect();
    let mut kept = BTreeSet::new();
    let mut next = vec![message.to_owned()];
    while let Some(name) = next.pop() {
        // What is declared within a message comes with it.
        let mut owner = name.as_str();
        while let Some((outer, _)) = owner.rsplit_once('.').filter(|_| !messages.contains_key(owner)) {
            owner = outer;
        }
        match messages.get(owner) {
            Some(message) if kept.insert(owner.to_owned()) => types(message, &mut next),
            Some(_) => {}
            // An enumeration beside the messages.
            None => drop(kept.insert(name)),
        }
    }
    let mut some = all.clone();
    for file in &mut some.file {
        let package = file.package().to_owned();
        file.message_type.retain(|message| kept.contains(&format!("{package}.{}", message.name())));
        file.enum_type.retain(|of| kept.contains(&format!("{package}.{}", of.name())));
    }
    some.file.retain(|file| !file.message_type.is_empty() || !file.enum_type.is_empty());
    let names: BTreeSet<String> = some.file.iter().map(|file| file.name().to_owned()).collect();
    some.file.iter_mut().for_each(|file| file.dependency.retain(|name| names.contains(name)));
    some
}

/// The names of the types of a message's fields, and of those of the messages within it.
fn types(message: &DescriptorProto, found: &mut Vec<String>) {
    let named = message.field.iter().filter_map(|field| field.type_name.as_deref());
    found.extend(named.map(|name| name.trim_start_matches('.').to_owned()));
    message.nested_type.iter().for_each(|nested| types(nested, found));
}
