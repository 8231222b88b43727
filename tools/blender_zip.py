"""Makes the Blender add-on's zip: python3 tools/blender_zip.py OUT.zip. The same sources give the same bytes: names
are sorted, all dates are equal, and nothing is compressed, because versions of zlib differ."""
import os
import sys
import zipfile

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))


def main():
    """Writes the zip that the command line names."""
    out = sys.argv[1]
    folder = os.path.join(ROOT, "blender")
    files = [(f"sherf/{name}", os.path.join(folder, name)) for name in os.listdir(folder)
             if name.endswith((".py", ".toml"))]
    files.append(("sherf/LICENSE", os.path.join(ROOT, "LICENSE")))
    os.makedirs(os.path.dirname(os.path.abspath(out)), exist_ok=True)
    with zipfile.ZipFile(out + ".part", "w", zipfile.ZIP_STORED) as z:
        for name, path in sorted(files):
            entry = zipfile.ZipInfo(name, (2026, 1, 1, 0, 0, 0))
            entry.external_attr, entry.create_system = 0o100644 << 16, 3
            with open(path, "rb") as f:
                z.writestr(entry, f.read())
    os.replace(out + ".part", out)
    print(f"{out}: {len(files)} files")


main()
