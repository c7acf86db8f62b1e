"""Writes a wheel of a package `baselines` with the files of OpenAI Baselines that matter here; prints its path."""

import sys
import zipfile
from pathlib import Path

path, info = Path(sys.argv[1]) / "baselines-0.1.6-py3-none-any.whl", "baselines-0.1.6.dist-info"
files = {
    "baselines/__init__.py": "",
    "baselines/deepq/__init__.py": "",
    f"{info}/METADATA": "Metadata-Version: 2.1\nName: baselines\nVersion: 0.1.6\n",
    f"{info}/WHEEL": "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
}
files[f"{info}/RECORD"] = "".join(f"{name},,\n" for name in (*files, f"{info}/RECORD"))
with zipfile.ZipFile(path, "w") as wheel:
    for name, content in files.items():
        wheel.writestr(name, content)
print(path)
