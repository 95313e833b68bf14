# docker build -t envgs-bench . && docker run --rm -v "$PWD/out:/envgs-bench/out" envgs-bench
# builds the CPU backend, for every kind of CPU that an image may come to, and runs the demo; the report is out/demo/index.html.
FROM python:3.12-slim

RUN apt-get update \
    && apt-get install --yes --no-install-recommends g++ make \
    && rm -rf /var/lib/apt/lists/*

WORKDIR /envgs-bench
COPY . .
RUN make install weights PIP_FLAGS="--compile --no-cache-dir --config-settings=cmake.define.CPUS=all --extra-index-url https://download.pytorch.org/whl/cpu"

ENV PATH="/envgs-bench/.venv/bin:$PATH"
CMD ["make", "demo"]
