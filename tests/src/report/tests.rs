use super::*;

fn folder() -> PathBuf {
    let folder = std::env::temp_dir().join(format!("plumbline-report-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    folder
}

#[test]
fn a_report_holds_its_plot_its_points_and_its_values() {
    let folder = folder();
    let mut report = Report::open_in(&folder, "reproduce", "trial", "A <trial>").unwrap();
    report.heading("One");
    report.paragraph("5 < 6 & so on");
    report.value("error", 0.25, "m", serde_json::json!({ "limit": 0.5 }));
    report.value("lost", f64::NAN, "m", Value::Null);
    report.skipped("other", "no data");
    let points = (0..20_000).map(|k| (f64::from(k), f64::from(k).sin())).chain([(3.0, f64::NAN)]).collect();
    let plot = Plot::new("Curve", "t, s", "z, m")
        .with(Series::line("truth", points))
        .with(Series::dashed("limit", vec![(0.0, 0.5), (1e4, 0.5)]))
        .with(Series::points("marks", vec![(5.0, 1.0)]))
        .band(5.0, 7.0);
    report.figure("curve", "A curve.", &plot).unwrap();
    report.table("rows", "Rows.", &["what", "m"], &[vec!["a, b".into(), "1.5".into()]]).unwrap();
    report.finish().unwrap();

    let read = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap();
    let page = read("index.html");
    assert!(page.contains("<svg") && page.contains("</svg>"), "the plot is inline");
    assert!(page.contains("A &lt;trial&gt;") && page.contains("5 &lt; 6 &amp; so on"));
    assert!(page.len() < 600_000, "a line of 20 000 points is thinned: {} bytes", page.len());
    // Every point as given, the heading, the limit and the mark.
    assert_eq!(read("curve.csv").lines().count(), 1 + 20_001 + 2 + 1);
    assert_eq!(read("rows.csv"), "what,m\n\"a, b\",1.5\n");
    let values: Vec<Value> = read("values.jsonl").lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(values[0]["reproduce"], "trial");
    assert_eq!((values[0]["value"].as_f64(), values[0]["limit"].as_f64()), (Some(0.25), Some(0.5)));
    assert!(values[1]["value"].is_null());
    assert_eq!(values[2]["skipped"], "no data");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_plot_without_a_finite_point_is_refused_by_name() {
    let empty =
        Plot::new("Empty", "t, s", "z, m").axes(Axis::Linear, Axis::Log).with(Series::line("a", vec![(0.0, -1.0)]));
    assert_eq!(empty.svg().unwrap_err().to_string(), "plot `Empty`: has no finite point");
}
