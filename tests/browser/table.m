% A table as .mat, read by Octave: what it holds, and the numbers of one column. Prints what it found, as JSON.
arguments = argv();
table = load(arguments{1});
numbers = table.data(strcmp(table.names, arguments{2}), :);
known = numbers(! isnan(numbers));
found = struct("version", version(), "rows", columns(table.data), "known", numel(known), "sum", sum(known));
found.columns = table.names;
found.unit = table.units{strcmp(table.names, arguments{2})};
found.event_text = table.event_text;
found.event_time_s = table.event_time_s;
printf("%s\n", jsonencode(found, "ConvertInfAndNaN", true));
