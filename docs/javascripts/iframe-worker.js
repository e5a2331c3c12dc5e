// Browsers start no workers from pages that are opened as files: there the search runs in a hidden frame.
(() => {
  if (location.protocol !== "file:") return
  window.Worker = class extends EventTarget {
    constructor(url) {
      super()
      this.onmessage = null
      this.waiting = []
      this.frame = document.createElement("iframe")
      this.frame.hidden = true
      document.body.append(this.frame)
      const inner = this.frame.contentWindow
      addEventListener("message", event => {
        if (event.source !== inner) return
        const passed = new MessageEvent("message", { data: event.data })
        this.dispatchEvent(passed)
        if (this.onmessage) this.onmessage(passed)
      })
      inner.postToPage = data => parent.postMessage(data, "*")
      const page = inner.document
      page.open()
      page.write(
        "<script>" +
          "postMessage = data => parent.dispatchEvent(new MessageEvent('message', {data, source: window}));" +
          "importScripts = (...urls) => urls.reduce((before, url) => before.then(() => new Promise(done => {" +
          "const script = document.createElement('script'); script.src = url; script.onload = done;" +
          "document.body.append(script)})), Promise.resolve())" +
          "</scr" + "ipt><body><script src='" + url + "'></scr" + "ipt></body>"
      )
      page.close()
      this.frame.addEventListener("load", () => {
        this.ready = true
        this.waiting.forEach(data => this.postMessage(data))
      })
    }
    postMessage(data) {
      if (!this.ready) return void this.waiting.push(data)
      this.frame.contentWindow.dispatchEvent(new MessageEvent("message", { data }))
    }
    terminate() {
      this.frame.remove()
    }
  }
})()
