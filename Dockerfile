# docker build -t slamsim . && docker run --rm -v "$PWD:/data" slamsim map labyrinth
FROM python:3.11-slim AS build
WORKDIR /src
COPY . .
RUN pip install --no-cache-dir --prefix=/installed -c constraints.txt .

FROM python:3.11-slim
RUN apt-get update \
    && apt-get install -y --no-install-recommends libegl1 libgl1 libx11-6 libusb-1.0-0 libgomp1 \
    && rm -rf /var/lib/apt/lists/*
COPY --from=build /installed /usr/local
# Kernels are compiled here once, so that no container compiles them again. They are code: the
# folder belongs to the user who runs them.
RUN useradd --create-home slamsim && mkdir /data && chown slamsim /data
USER slamsim
RUN cd /tmp && slamsim map tiny --set sensors.lidar=lds_01 --quiet && rm -r /tmp/outputs
WORKDIR /data
ENTRYPOINT ["slamsim"]
CMD ["--help"]
