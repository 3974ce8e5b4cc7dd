# docker build -t magyc-gtsam . && docker run --rm -v "$PWD:/data" magyc-gtsam calibrate dive.mcap
FROM python:3.12-slim
COPY . /src
RUN pip install --no-cache-dir -c /src/.ci/container.txt '/src[px4,ardupilot]' && rm -rf /src
WORKDIR /data
ENTRYPOINT ["magyc-gtsam"]
CMD ["--help"]
