"""The same table as CSV, Parquet and .mat, read by others: DuckDB, Polars and scipy. Prints what each found, as JSON."""

import csv
import json
import math
import sys

import duckdb
import polars
import scipy
import scipy.io

by_csv, by_parquet, by_mat, column, text = sys.argv[1:]


def found(names, values, **more):
    known = [value for value in values if value is not None and not math.isnan(value)]
    return {"columns": list(names), "rows": len(values), "known": len(known), "sum": sum(known), **more}


with open(by_csv, newline="") as file:
    rows = list(csv.DictReader(file))
numbers = [float(row[column]) if row[column] else None for row in rows]
tables = {"csv": found(rows[0], numbers, texts=[row[text] for row in rows if row[text]])}

relation = duckdb.connect().from_parquet(by_parquet)
values = [row[0] for row in relation.select(f'"{column}"').fetchall()]
texts = [row[0] for row in relation.select(f'"{text}"').fetchall() if row[0] is not None]
types = dict(zip(relation.columns, map(str, relation.types)))
tables["duckdb"] = found(relation.columns, values, texts=texts, version=duckdb.__version__, types=types)
metadata = duckdb.connect().execute("select key, value from parquet_kv_metadata(?)", [by_parquet]).fetchall()
tables["duckdb"]["units"] = {key.decode(): json.loads(value) for key, value in metadata}["units"]

frame = polars.read_parquet(by_parquet)
texts = [value for value in frame[text].to_list() if value is not None]
tables["polars"] = found(frame.columns, frame[column].to_list(), texts=texts, version=polars.__version__)

mat = scipy.io.loadmat(by_mat)
names = [name[0] for name in mat["names"][:, 0]]
texts = [str(value[0]) for value in mat["event_text"][:, 0]]
row = mat["data"][names.index(column)]
tables["scipy"] = found(names, row.tolist(), texts=texts, version=scipy.__version__)
tables["scipy"]["units"] = {name: unit[0] if unit.size else "" for name, unit in zip(names, mat["units"][:, 0])}
tables["scipy"]["event_time_s"] = mat["event_time_s"][:, 0].tolist()

json.dump(tables, sys.stdout)
