// Browsers start no worker for a page that was opened from the disk. There the search runs in a hidden frame instead,
// which is handed its messages as a worker would be. Named so that the theme's plugin `offline` loads none from the web.
class FrameWorker extends EventTarget {
  constructor(url) {
    super()
    this.onmessage = null
    this.frame = document.createElement("iframe")
    this.frame.hidden = true
    document.body.appendChild(this.frame)
    window.addEventListener("message", event => {
      if (event.source !== this.frame.contentWindow) return
      const copy = new MessageEvent("message", { data: event.data })
      this.dispatchEvent(copy)
      if (this.onmessage) this.onmessage(copy)
    })
    // scripts of the frame: messages go to the page, and further scripts are loaded one after the other
    const inside = `
      var postMessage = data => parent.postMessage(data, "*")
      var importScripts = (...urls) => urls.reduce((before, url) => before.then(() => new Promise((done, failed) => {
        const script = document.createElement("script")
        script.src = url
        script.onload = done
        script.onerror = failed
        document.body.appendChild(script)
      })), Promise.resolve())`
    this.ready = new Promise(done => {
      const page = this.frame.contentDocument
      page.open()
      page.write(`<html><body><script>${inside}<\/script><script src="${url}"><\/script></body></html>`)
      page.close()
      this.frame.onload = done
    })
  }

  postMessage(data) {
    this.ready.then(() => this.frame.contentWindow.dispatchEvent(new MessageEvent("message", { data })))
  }

  terminate() {
    this.frame.remove()
  }
}
if (location.protocol === "file:") window.Worker = FrameWorker
